// The view to turn, linked to the lists of readings and to their residuals.
class SceneView {
  constructor(data) {
    this.data = data;
    this.canvas = document.getElementById('scene');
    this.picked = -1;
    const all = [...data.lines.flatMap(l => l.points), ...data.readings.map(r => r.at), ...data.fields.flatMap(f => f.at)];
    this.whole = [...data.lines.flatMap(l => l.points), ...data.readings.flatMap(r => r.far ? [r.at, r.far] : [r.at])];
    if (!this.whole.length) this.whole = all;
    this.camera = new Camera(this.whole);
    this.setups = [...new Set(data.readings.map(r => r.setup))];
    document.getElementById('view').hidden = false;
    this.controls();
    this.list();
    const pick = k => this.pick(k);
    this.bars = new Bars(document.getElementById('residual-bars'), data.readings, pick);
    this.polars = data.circles.map(circle => new Polar(circle, pick));
    document.getElementById('polars').append(...this.polars.map(p => p.box));
    this.pointer();
    this.keys();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    addEventListener('resize', () => { this.bars.draw?.(); this.mark(); });
    document.addEventListener('theme', () => this.draw());
    this.draw();
    page.hints();
  }

  layer(name) {
    return document.querySelector(`[data-layer="${name}"]`).checked;
  }

  controls() {
    const field = document.getElementById('field'), state = document.getElementById('state');
    this.data.fields.forEach((f, k) => field.append(element('option', {value: String(k)}, f.name)));
    document.getElementById('field-tools').hidden = !this.data.fields.length;
    document.querySelector('[data-layer="labels"]').parentElement.hidden = !this.data.labels.length;
    for (const node of [field, state, ...document.querySelectorAll('[data-layer]')]) node.addEventListener('change', () => this.draw());
    const views = {front: [-90, 0], side: [0, 0], top: [-90, 90], home: [this.camera.home.azimuth, this.camera.home.elevation]};
    for (const button of document.querySelectorAll('[data-turn]')) {
      button.addEventListener('click', () => { this.camera.turn(...views[button.dataset.turn]); this.draw(); });
    }
    for (const button of document.querySelectorAll('[data-zoom]')) {
      button.addEventListener('click', () => {
        if (button.dataset.zoom === 'readings') this.look();
        else this.camera.zoom *= Number(button.dataset.zoom);
        this.draw();
      });
    }
  }

  // The readings alone, or everything again.
  look() {
    const tips = this.data.readings.map(r => r.at);
    this.close = !this.close && tips.length > 0;
    this.camera.frame(this.close ? tips : this.whole);
  }

  list() {
    const several = this.setups.length > 1;
    const runs = new Set(this.data.readings.map(r => r.run)).size > 1;
    const fitted = this.data.readings.some(r => r.residuals.length);
    const titles = ['No.', ...(several ? ['Set-up'] : []), ...(runs ? ['Run'] : []), 'Command', ...(fitted ? ['Residual'] : [])];
    const head = element('tr', {}, ...titles.map(t => element('th', {scope: 'col'}, t)));
    const rows = this.data.readings.map((r, k) => {
      const residual = r.residuals.map(e => `${digits(e.after)}\u00a0${e.unit}`).join(', ');
      const before = [String(k + 1), ...(several ? [r.setup] : []), ...(runs ? [r.run] : [])];
      const plain = c => element('td', {}, c), wrapped = c => element('td', {class: 'command'}, c);
      return element('tr', {'data-reading': k}, ...before.map(plain), ...[r.words, ...(fitted ? [residual] : [])].map(wrapped));
    });
    document.getElementById('reading-list').append(element('table', {class: 'dense'}, element('thead', {}, head), element('tbody', {}, ...rows)));
    for (const row of document.querySelectorAll('tr[data-reading]')) {
      const reading = Number(row.dataset.reading), cell = row.cells[0];
      if (reading >= this.data.readings.length) continue;
      const button = element('button', {type: 'button', class: 'pick', 'aria-label': `Show reading ${reading + 1}`}, cell.textContent);
      cell.replaceChildren(button);
      const inView = row.closest('#view');
      row.addEventListener('click', () => {
        this.pick(reading);
        if (!inView) document.getElementById('view').scrollIntoView({block: 'start'});
      });
    }
  }

  pick(k) {
    this.picked = k === this.picked ? -1 : k;
    const reading = this.data.readings[this.picked], words = document.getElementById('picked');
    if (reading) {
      const residuals = reading.residuals.map(e => `${e.channel} ${digits(e.before)} ${e.unit} before, ${digits(e.after)} ${e.unit} after the fit`);
      words.textContent = [`Reading ${k + 1}: ${reading.setup}${reading.run ? ', run ' + reading.run : ''}`, reading.words, ...residuals].join('; ') + '.';
    } else words.textContent = 'Touch a reading in the drawing or in the list.';
    this.draw();
    this.mark();
    const row = document.querySelector(`#reading-list tr[data-reading="${this.picked}"]`);
    if (row) {
      const box = document.getElementById('reading-list');
      const above = row.offsetTop - box.scrollTop;
      if (above < 30 || above > box.clientHeight - 40) box.scrollTop = row.offsetTop - box.clientHeight / 2;
    }
  }

  mark() {
    for (const node of document.querySelectorAll('[data-reading]')) {
      node.classList.toggle('picked', Number(node.dataset.reading) === this.picked);
    }
  }

  // -- drawing

  draw() {
    const canvas = this.canvas, ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    this.camera.size(width, height);
    const pen = this.pen = canvas.getContext('2d');
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.axes();
    if (this.layer('bars')) this.drawBars();
    if (this.layer('machine')) this.drawMachine();
    this.drawField();
    if (this.layer('readings')) this.drawReadings();
    if (this.layer('labels')) this.drawLabels();
    this.drawPicked();
    Object.assign(canvas.dataset, {azimuth: this.camera.azimuth.toFixed(2), elevation: this.camera.elevation.toFixed(2), picked: this.picked});
  }

  path(points, colour, width, dash = []) {
    const pen = this.pen;
    pen.beginPath();
    points.forEach((p, k) => { const [x, y] = this.camera.project(p); if (k) pen.lineTo(x, y); else pen.moveTo(x, y); });
    Object.assign(pen, {strokeStyle: colour, lineWidth: width, lineJoin: 'round', lineCap: 'round'});
    pen.setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
  }

  dot(point, colour, size) {
    const [x, y] = this.camera.project(point), pen = this.pen;
    pen.beginPath();
    pen.arc(x, y, size, 0, 2 * Math.PI);
    pen.fillStyle = colour;
    pen.fill();
  }

  write(words, x, y, colour) {
    const pen = this.pen;
    Object.assign(pen, {font: '12px system-ui, sans-serif', lineWidth: 3, strokeStyle: page.colour('paper'), fillStyle: colour});
    pen.strokeText(words, x, y);
    pen.fillText(words, x, y);
  }

  // Directions of the base frame and a length in a corner.
  axes() {
    const origin = [26, this.camera.height - 30], [cx, cy] = this.camera.project(this.camera.centre);
    const one = this.camera.radius / 4;
    ['x', 'y', 'z'].forEach((name, k) => {
      const tip = this.camera.centre.map((v, j) => v + (j === k ? one : 0)), [x, y] = this.camera.project(tip);
      const length = 0.115 * Math.min(this.camera.width, this.camera.height) * this.camera.zoom;
      const [dx, dy] = [22 * (x - cx) / length, 22 * (y - cy) / length], pen = this.pen;
      pen.beginPath();
      pen.moveTo(...origin);
      pen.lineTo(origin[0] + dx, origin[1] + dy);
      Object.assign(pen, {strokeStyle: page.colour('soft'), lineWidth: 1.5});
      pen.stroke();
      if (Math.hypot(dx, dy) > 5) this.write(name, origin[0] + 1.35 * dx - 3, origin[1] + 1.35 * dy + 4, page.colour('soft'));
    });
    const scale = this.camera.zoom * 0.46 * Math.min(this.camera.width, this.camera.height) / this.camera.radius;
    const length = round(0.28 * this.camera.width / scale), right = this.camera.width - 14, low = this.camera.height - 14;
    this.pen.fillStyle = page.colour('soft');
    this.pen.fillRect(right - length * scale, low, length * scale, 2);
    this.pen.textAlign = 'right';
    this.write(`${digits(length)} mm`, right, low - 6, page.colour('soft'));
    this.pen.textAlign = 'left';
  }

  drawMachine() {
    for (const line of this.data.lines) {
      if (line.points.length === 1) this.dot(line.points[0], page.colour('orange'), 4);
      else this.path(line.points, page.colour(line.kind === 'machine' ? 'ink' : 'faint'), line.kind === 'machine' ? 2.5 : 1, line.kind === 'path' ? [2, 3] : []);
    }
  }

  drawBars() {
    for (const r of this.data.readings) if (r.far) this.path([r.far, r.at], page.colour('line'), 1);
  }

  colourOf(setup) {
    return page.colour(['blue', 'orange', 'green', 'red'][this.setups.indexOf(setup) % 4]);
  }

  drawReadings() {
    // Below an error map, readings are small.
    const small = this.data.readings.length > 300 || document.getElementById('field').value !== '';
    const size = small ? 2.5 : 4;
    const far = this.data.readings.map((r, k) => [this.camera.project(r.at)[2], k]).sort((a, b) => a[0] - b[0]);
    for (const [, k] of far) this.dot(this.data.readings[k].at, this.colourOf(this.data.readings[k].setup), size);
  }

  drawLabels() {
    for (const label of this.data.labels) {
      const [x, y] = this.camera.project(label.at);
      this.dot(label.at, page.colour('pick'), 2);
      this.write(label.text, x + 5, y - 4, page.colour('blue'));
    }
  }

  drawPicked() {
    const reading = this.data.readings[this.picked];
    if (!reading) return;
    if (reading.far) this.path([reading.far, reading.at], page.colour('pick'), 2.5);
    this.dot(reading.at, page.colour('paper'), 10);
    this.dot(reading.at, page.colour('pick'), 7);
    const [x, y] = this.camera.project(reading.at);
    this.write(String(this.picked + 1), x + 10, y - 8, page.colour('pick'));
  }

  // Small sizes light, large ones dark, whatever the theme: yellow, orange, red, violet.
  ramp(share) {
    const stops = [[253, 216, 93], [244, 140, 54], [205, 65, 80], [110, 40, 130]];
    const at = Math.max(0, Math.min(2.999, share * 3)), k = Math.floor(at), f = at - k;
    return `rgb(${stops[k].map((v, i) => Math.round(v + f * (stops[k + 1][i] - v))).join(',')})`;
  }

  drawField() {
    const field = this.data.fields[document.getElementById('field').value], legend = document.getElementById('ramp');
    legend.replaceChildren();
    if (!field) return;
    const values = field[document.getElementById('state').value];
    const known = values.filter(v => v !== null), low = Math.min(...known), high = Math.max(...known);
    const span = high - low || 1;
    const far = field.at.map((p, k) => [this.camera.project(p)[2], k]).sort((a, b) => a[0] - b[0]);
    for (const [, k] of far) {
      if (values[k] === null) continue;
      const share = (values[k] - low) / span;
      this.dot(field.at[k], this.ramp(share), 3 + 5 * share);
    }
    const bar = element('i', {});
    bar.style.background = `linear-gradient(90deg, ${[0, 1, 2, 3].map(k => this.ramp(k / 3)).join(', ')})`;
    legend.append(digits(low), bar, `${digits(high)} ${field.unit}`);
  }

  // -- hands

  pointer() {
    const canvas = this.canvas, held = new Map();
    let moved = 0, spread = 0;
    const distance = () => { const [a, b] = [...held.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
    canvas.addEventListener('pointerdown', e => {
      held.set(e.pointerId, {x: e.clientX, y: e.clientY});
      canvas.setPointerCapture(e.pointerId);
      if (held.size === 1) moved = 0;
      if (held.size === 2) spread = distance();
    });
    canvas.addEventListener('pointermove', e => {
      const last = held.get(e.pointerId);
      if (!last) return;
      const dx = e.clientX - last.x, dy = e.clientY - last.y;
      held.set(e.pointerId, {x: e.clientX, y: e.clientY});
      moved += Math.abs(dx) + Math.abs(dy);
      if (held.size === 2) {
        this.camera.zoom *= distance() / spread;
        spread = distance();
      } else this.camera.turn(this.camera.azimuth - 0.4 * dx, this.camera.elevation + 0.4 * dy);
      this.draw();
    });
    const release = e => {
      if (e.type === 'pointerup' && held.size === 1 && moved < 6) this.pickAt(e);
      held.delete(e.pointerId);
    };
    canvas.addEventListener('pointerup', release);
    canvas.addEventListener('pointercancel', release);
    canvas.addEventListener('wheel', e => {
      if (document.activeElement !== canvas) return;
      e.preventDefault();
      this.camera.zoom *= Math.exp(-e.deltaY / 500);
      this.draw();
    }, {passive: false});
  }

  pickAt(e) {
    const box = this.canvas.getBoundingClientRect(), reach = e.pointerType === 'touch' ? 26 : 14;
    const [x, y] = [e.clientX - box.left, e.clientY - box.top];
    let best = -1, least = reach;
    this.data.readings.forEach((r, k) => {
      const [px, py] = this.camera.project(r.at), d = Math.hypot(px - x, py - y);
      if (d < least) [best, least] = [k, d];
    });
    if (best >= 0) this.pick(best);
  }

  keys() {
    const turns = {ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5]};
    this.canvas.addEventListener('keydown', e => {
      const turn = turns[e.key];
      if (turn) this.camera.turn(this.camera.azimuth + turn[0], this.camera.elevation + turn[1]);
      else if (e.key === '+') this.camera.zoom *= 1.25;
      else if (e.key === '-') this.camera.zoom *= 0.8;
      else return;
      e.preventDefault();
      this.draw();
    });
  }
}

const viewData = document.getElementById('view-data');
if (viewData) new SceneView(JSON.parse(viewData.textContent));
