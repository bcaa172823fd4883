// A new study: the drawing follows the sizes, an error stands at its field.
const study = {
  form: document.getElementById('study'), view: null, waits: 0,

  values() {
    const values = {machine: '', name: '', instrument: '', time: '', sizes: {}, wanted: {}};
    for (const [name, value] of new FormData(study.form)) {
      if (name.startsWith('wanted.')) values.wanted[name.slice(7)] = value;
      else values[name] = value;
    }
    for (const size of study.form.querySelectorAll('fieldset.size')) values.sizes[size.name.slice(9)] = study.size(size);
    return values;
  },

  // The numbers of a table as the study writes them, `[[1, 2], [3, 4]]`; nothing of an empty one.
  size(fieldset) {
    const rows = [...fieldset.querySelectorAll('tr')].map(row => [...row.querySelectorAll('td input')].map(cell => cell.value.trim().replace(',', '.'))).filter(row => row.length);
    if (rows.flat().every(cell => cell === '')) return '';
    const lists = rows.filter(row => row.some(cell => cell !== '')).map(row => '[' + row.join(', ') + ']');
    if ('nested' in fieldset.dataset) return '[' + lists.join(', ') + ']';
    return rows[0].length > 1 ? lists[0] : rows[0][0];
  },

  // One more row of a table, empty.
  grow(fieldset) {
    const rows = fieldset.querySelectorAll('tr'), row = rows[rows.length - 1].cloneNode(true);
    row.querySelector('th').textContent = rows.length;
    for (const cell of row.querySelectorAll('input')) { cell.value = ''; cell.setAttribute('aria-label', cell.getAttribute('aria-label').replace(/, \d+,/, `, ${rows.length},`)); }
    rows[rows.length - 1].after(row);
    row.querySelector('input').focus();
  },

  // Places around a circle: in pairs a third of a turn apart where they are six, in even steps where they are odd.
  fill(fieldset) {
    const entry = name => Number(fieldset.querySelector(`[data-circle="${name}"]`)?.value.replace(',', '.') || 0);
    const rows = [...fieldset.querySelectorAll('tr')].filter(row => row.querySelector('td input'));
    const pairs = rows.length % 2 === 0;
    rows.forEach((row, k) => {
      const step = pairs ? 720 / rows.length * Math.floor(k / 2) + (k % 2 ? .5 : -.5) * entry('between') : 360 / rows.length * k;
      const angle = (entry('first') + step) * Math.PI / 180, radius = entry('diameter') / 2;
      [radius * Math.cos(angle), radius * Math.sin(angle), entry('height')].forEach((value, axis) => {
        const cell = row.querySelectorAll('td input')[axis];
        if (cell) cell.value = String(Number(value.toFixed(6)));
      });
    });
    study.draw();
  },

  // The error of an answer at its field, and nothing at the others.
  tell(answer) {
    for (const node of study.form.querySelectorAll('.fault')) node.remove();
    for (const node of study.form.querySelectorAll('[aria-invalid]')) { node.removeAttribute('aria-invalid'); node.removeAttribute('aria-describedby'); }
    document.getElementById('said').textContent = '';
    if (!answer.error) return;
    const field = answer.field && study.form.elements[answer.field];
    if (!field) { document.getElementById('said').textContent = answer.error; return; }
    const words = element('span', {class: 'fault', id: 'fault'}, answer.error);
    field.setAttribute('aria-invalid', 'true');
    field.setAttribute('aria-describedby', 'fault');
    if (field.tagName === 'FIELDSET') field.append(words); else field.after(words);
  },

  async draw() {
    const answer = await send('/new/draw', study.values());
    study.tell(answer);
    if (!answer.view) return;
    if (study.view) { study.view.data = answer.view; study.view.camera.frame(answer.view.lines.flatMap(l => l.points)); study.view.draw(); }
    else study.view = new SceneView(answer.view);
  },

  async write() {
    document.getElementById('said').textContent = 'Writes and checks the study …';
    const answer = await send('/new', study.values());
    study.tell(answer);
    if (answer.status === 200) location.href = '/';
    else if (answer.field) study.form.elements[answer.field]?.focus();
  },
};
study.form.addEventListener('submit', event => { event.preventDefault(); study.write(); });
study.form.addEventListener('input', event => {
  if (!event.target.closest('fieldset.size table')) return;
  clearTimeout(study.waits);
  study.waits = setTimeout(study.draw, 400);
});
for (const button of study.form.querySelectorAll('[data-fill]')) button.addEventListener('click', () => study.fill(button.closest('fieldset')));
for (const button of study.form.querySelectorAll('[data-grow]')) button.addEventListener('click', () => study.grow(button.closest('fieldset')));
study.form.elements.machine.addEventListener('change', event => { location.href = '/new?machine=' + encodeURIComponent(event.target.value); });
study.draw();
