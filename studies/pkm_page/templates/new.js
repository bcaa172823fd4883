// A new study: the drawing follows the sizes, an error stands at its field.
const study = {
  form: document.getElementById('study'), view: null, waits: 0,

  values() {
    const values = {machine: '', name: '', instrument: '', minutes: '', sizes: {}, wanted: {}};
    for (const [name, value] of new FormData(study.form)) {
      const [group, key] = name.split(/\.(.*)/s);
      if (group === 'geometry') values.sizes[key] = value;
      else if (group === 'wanted') values.wanted[key] = value;
      else values[name] = value;
    }
    return values;
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
    field.after(words);
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
  if (!event.target.name?.startsWith('geometry.')) return;
  clearTimeout(study.waits);
  study.waits = setTimeout(study.draw, 400);
});
study.form.elements.machine.addEventListener('change', event => { location.href = '/new?machine=' + encodeURIComponent(event.target.value); });
study.draw();
