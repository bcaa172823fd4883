// Residuals of all readings as bars, and of circles about the circle, magnified.
const svg = (name, attributes, ...children) => {
  const node = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
};
const element = (name, attributes, ...children) => {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
};
const digits = value => value === null ? '\u2013' : String(Number(value.toPrecision(3))).replace('-', '\u2212');
const largest = values => Math.max(1e-12, ...values.map(Math.abs));
// 1, 2 or 5 times a power of ten, at most the value.
const round = value => {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map(k => k * power).find(size => size <= value * 1.0000001) ?? power;
};

class Bars {
  constructor(box, readings, pick) {
    this.box = box;
    this.pick = pick;
    this.marks = readings.flatMap((r, k) => r.residuals.map(e => ({...e, reading: k})));
    this.channels = [...new Set(this.marks.map(m => m.channel))];
    if (!this.marks.length) return;
    this.state = element('select', {'aria-label': 'Residuals before or after the fit'},
      element('option', {value: 'after'}, 'after the fit'), element('option', {value: 'before'}, 'before the fit'));
    this.state.addEventListener('change', () => this.draw());
    this.channel = element('select', {'aria-label': 'Channel'}, ...this.channels.map(c => element('option', {value: c}, c)));
    this.channel.addEventListener('change', () => this.draw());
    this.channel.hidden = this.channels.length < 2;
    this.drawing = element('div', {});
    box.className = 'chart';
    box.append(element('p', {}, 'Residuals of the readings', this.channel, this.state), this.drawing);
    this.draw();
  }

  draw() {
    if (!this.marks.length) return;
    const width = Math.max(280, this.box.clientWidth), height = 170, edge = 52;
    const marks = this.marks.filter(m => m.channel === this.channel.value);
    const values = marks.map(m => m[this.state.value]);
    const top = largest(values), step = round(top), unit = marks[0].unit;
    const x = k => edge + (k + 0.5) * (width - edge - 8) / marks.length;
    const y = v => 75 - 62 * v / top;
    const chart = svg('svg', {viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': `Residual of each reading, largest ${digits(top)} ${unit}`});
    for (const tick of [-step, 0, step]) {
      chart.append(svg('line', {class: tick ? 'axis' : 'zero', x1: edge, x2: width - 4, y1: y(tick), y2: y(tick)}));
      chart.append(svg('text', {x: edge - 6, y: y(tick) + 4, 'text-anchor': 'end'}, digits(tick)));
    }
    chart.append(svg('text', {x: 2, y: 164}, unit), svg('text', {x: width - 4, y: 164, 'text-anchor': 'end'}, 'number of the reading'));
    const every = Math.max(1, Math.ceil(marks.length / Math.max(4, Math.floor(width / 60))));
    const broad = Math.max(2, Math.min(16, 0.7 * (width - edge) / marks.length));
    marks.forEach((mark, k) => {
      const value = values[k], from = Math.min(y(0), y(value));
      const bar = svg('rect', {class: 'mark', x: x(k) - broad / 2, y: from - 1, width: broad, height: Math.abs(y(value) - y(0)) + 2, 'data-reading': mark.reading});
      bar.append(svg('title', {}, `reading ${mark.reading + 1}: ${digits(value)} ${unit}`));
      bar.addEventListener('click', () => this.pick(mark.reading));
      chart.append(bar);
      if (k % every === 0) chart.append(svg('text', {x: x(k), y: 150, 'text-anchor': 'middle'}, mark.reading + 1));
    });
    this.drawing.replaceChildren(chart);
  }
}

class Polar {
  constructor(circle, pick) {
    this.circle = circle;
    this.pick = pick;
    this.top = largest(circle.passes.flatMap(p => p.before));
    this.state = element('select', {'aria-label': 'Before or after'}, element('option', {value: 'before'}, 'before'), element('option', {value: 'after'}, 'after'));
    this.gain = element('input', {type: 'range', min: '0', max: '10', step: '0.5', value: '5', 'aria-label': 'Magnification of the residuals of ' + circle.name});
    this.scale = element('span', {});
    this.drawing = element('div', {});
    for (const control of [this.state, this.gain]) control.addEventListener('input', () => this.draw());
    this.box = element('div', {class: 'chart'}, element('p', {}, circle.name), this.drawing,
      element('p', {}, this.state, element('label', {}, 'magnify ', this.gain), this.scale));
    this.draw();
  }

  draw() {
    const size = 300, middle = size / 2, radius = 86;
    // Half way along the slider, the largest residual before is 40 pixels.
    const pixels = 40 / this.top * 2 ** (Number(this.gain.value) - 5);
    const ruler = round(40 / pixels);
    const at = (angle, r) => [middle + r * Math.cos(angle * Math.PI / 180), middle - r * Math.sin(angle * Math.PI / 180)];
    const chart = svg('svg', {viewBox: `0 0 ${size} ${size}`, role: 'img', 'aria-label': `Residuals about the circle ${this.circle.name}`});
    chart.append(svg('circle', {class: 'zero', cx: middle, cy: middle, r: radius}));
    for (const angle of [0, 90, 180, 270]) {
      const [x, y] = at(angle, 138), [x1, y1] = at(angle, radius - 5), [x2, y2] = at(angle, radius + 5);
      chart.append(svg('line', {class: 'zero', x1, y1, x2, y2}), svg('text', {x, y: y + 4, 'text-anchor': 'middle'}, angle + '\u00b0'));
    }
    this.circle.passes.forEach((pass, k) => {
      const places = pass[this.state.value].map((v, i) => at(pass.at[i], Math.max(4, Math.min(128, radius + pixels * v))));
      chart.append(svg('polygon', {class: k % 2 ? 'b' : 'a', points: places.map(p => p.map(v => v.toFixed(1)).join(',')).join(' ')}));
      places.forEach(([cx, cy], i) => {
        const reading = pass.readings[i];
        const dot = svg('circle', {class: 'mark', cx, cy, r: 3});
        dot.append(svg('title', {}, `${pass.name}, ${digits(pass.at[i])}\u00b0: ${digits(pass[this.state.value][i])} ${this.circle.unit}`));
        if (reading !== undefined) {
          dot.setAttribute('data-reading', reading);
          dot.addEventListener('click', () => this.pick(reading));
        }
        chart.append(dot);
      });
    });
    const half = pixels * ruler / 2;
    chart.append(svg('line', {class: 'zero', x1: middle - half, x2: middle + half, y1: middle, y2: middle, 'stroke-width': 3}));
    chart.append(svg('text', {x: middle, y: middle + 18, 'text-anchor': 'middle'}, `${digits(ruler)} ${this.circle.unit}`));
    this.drawing.replaceChildren(chart);
    const values = this.circle.passes.flatMap(p => p[this.state.value]);
    const rms = Math.sqrt(values.reduce((sum, v) => sum + v * v, 0) / Math.max(1, values.length));
    this.scale.textContent = `rms ${digits(rms)} ${this.circle.unit}`;
  }
}
