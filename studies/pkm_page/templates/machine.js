// The page at the machine: entries to the server, its state into the page.
class LiveView extends SceneView {
  update(data) {
    const {azimuth, elevation, zoom} = this.camera;
    this.data = data;
    this.whole = [...data.lines.flatMap(l => l.points), ...data.readings.flatMap(r => r.far ? [r.at, r.far] : [r.at])];
    this.camera.frame(this.close ? data.readings.map(r => r.at) : this.whole);
    Object.assign(this.camera, {azimuth, elevation, zoom});
    this.setups = [...new Set(data.readings.map(r => r.setup))];
    document.getElementById('reading-list').replaceChildren();
    this.list();
    document.getElementById('residual-bars').replaceChildren();
    this.bars = new Bars(document.getElementById('residual-bars'), data.readings, k => this.pick(k));
    this.next();
  }

  // Mark the reading that is to be taken: the last one.
  next() {
    this.picked = -1;
    this.pick(this.data.readings.length - 1);
    document.getElementById('picked').textContent = 'Marked: the next reading. Touch another one to see it.';
  }
}

const live = {
  state: JSON.parse(document.getElementById('live-data').textContent),
  view: null, key: null, offer: 0, taking: null, last: Promise.resolve(),

  node: name => document.getElementById(name === 'decide' ? 'decide-part' : name),

  start() {
    live.parts = Object.fromEntries(['pose', 'know', 'decide'].map(n => [n, null]));
    live.draw();
    live.newKey();
    live.fill();
    document.addEventListener('submit', event => { if (event.target.id === 'entry') { event.preventDefault(); live.take(false); } });
    document.addEventListener('click', live.click);
    document.getElementById('ask-yes').addEventListener('click', () => live.take(true));
    document.getElementById('ask-no').addEventListener('click', () => { live.ask([]); live.focus(true); });
    live.listen();
    live.focus(false);
  },

  // An entry that is sent twice, as after a lost answer, has one key and is taken once.
  newKey() { live.key = Array.from(crypto.getRandomValues(new Uint32Array(4)), n => n.toString(16)).join(''); },

  draw() {
    if (!live.state.view) return;
    if (live.view) live.view.update(live.state.view);
    else { live.view = new LiveView(live.state.view); live.view.next(); }
  },

  listen() {
    const source = new EventSource('/events');
    source.onmessage = () => live.load();
    source.onopen = () => live.online(true);
    source.onerror = () => {
      live.online(false);
      // A server that was started anew refuses for a moment: the browser gives up, this does not.
      if (source.readyState === EventSource.CLOSED) setTimeout(live.listen, 1000);
    };
  },

  online(is) { document.getElementById('offline').hidden = is; },

  async load() {
    try {
      const answer = await fetch('/state');
      if (answer.ok) live.show(await answer.json());
    } catch { live.online(false); }
  },

  show(state) {
    // Answers may overtake each other: an older state is no news.
    if (BigInt(state.number) < BigInt(live.state.number)) return;
    const before = live.state.version, open = [...document.querySelectorAll('main details[open]')].map(d => d.id);
    const padded = document.getElementById('pad')?.hidden === false;
    const drawn = JSON.stringify(live.state.view);
    live.state = state;
    for (const [name, words] of Object.entries(state.parts)) {
      if (live.parts[name] === words) continue;
      const kept = name === 'pose' && before === state.version ? live.typed() : null;
      live.parts[name] = words;
      if (name === 'pose') document.getElementById('pose').after(document.getElementById('ask'));
      live.node(name).innerHTML = words;
      if (kept) live.retype(kept);
    }
    for (const id of open) if (id) document.getElementById(id)?.setAttribute('open', '');
    if (padded) live.pad(true);
    // The state after a reading may come before the answer to it: the next entry is free by then.
    if (before !== state.version) { live.newKey(); live.ask([]); live.taking = null; }
    if (drawn !== JSON.stringify(state.view)) live.draw();
    live.fill();
    page.hints();
  },

  inputs: () => [...document.querySelectorAll('#entry input, #entry select')],
  typed: () => ({values: live.inputs().map(i => i.value), at: live.inputs().indexOf(document.activeElement)}),
  // Who types goes on typing, at the end of what is there.
  retype({values, at}) {
    live.inputs().forEach((input, k) => { input.value = values[k] ?? ''; });
    live.inputs()[at]?.focus({preventScroll: true});
  },

  // What arrived by line goes into entries that nobody has typed into.
  fill() {
    const offer = live.state.offer;
    if (offer && offer.number !== live.offer) {
      const inputs = [...document.querySelectorAll('#entry [name="value"]')];
      if (inputs.every(i => !i.value || i.dataset.line)) inputs.forEach((i, k) => { i.value = offer.entries[k]; i.dataset.line = '1'; });
      live.offer = offer.number;
    }
    if (live.state.doubt) live.say(live.state.doubt);
  },

  focus(always) {
    // On a tablet the keyboard opens only when a person touches the entry.
    if (always || matchMedia('(pointer: fine)').matches) document.getElementById('first-value')?.focus({preventScroll: true});
  },

  say(words) { document.getElementById('said').textContent = words || ''; },

  ask(sentences) {
    const box = document.getElementById('ask');
    box.hidden = !sentences.length;
    document.getElementById('ask-words').replaceChildren(...sentences.map(words => element('p', {}, words)));
    // A doubt stands beside the entry that it doubts.
    if (sentences.length) document.querySelector('#entry .values')?.after(box);
    if (sentences.length) { document.getElementById('ask-no').focus(); box.scrollIntoView({block: 'nearest'}); }
  },

  // One request after the other: an entry waits for an undo that is on its way.
  request(path, values) {
    live.last = live.last.then(() => live.ask_server(path, values));
    return live.last;
  },

  async ask_server(path, values) {
    try {
      const answer = await send(path, values);
      live.online(true);
      if (answer.parts) live.show(answer);
      live.say(answer.error);
      return answer;
    } catch {
      live.online(false);
      live.say('The server does not answer. Nothing is known to be taken: send it again.');
      return null;
    }
  },

  async take(confirmed) {
    const form = document.getElementById('entry');
    if (live.taking) return;
    const entries = [...form.querySelectorAll('[name="value"]')].map(i => i.value);
    const empty = [...form.querySelectorAll('[name="value"]')].find(i => !i.value.trim());
    if (empty) { live.say('Type the reading first.'); empty.focus(); return; }
    const taking = live.taking = {};
    const button = form.querySelector('[type="submit"]');
    button.setAttribute('aria-busy', 'true');
    button.textContent = 'Checks …';
    const answer = await live.request('/reading', {version: form.dataset.version, key: live.key, entries, remark: form.elements.remark.value, direction: form.elements.direction?.value ?? '', confirmed});
    if (live.taking === taking) live.taking = null;
    button.removeAttribute('aria-busy');
    button.textContent = 'Take';
    if (!answer) return;
    live.ask(answer.doubts || []);
    if (answer.status === 200 && !live.inputs().includes(document.activeElement)) live.focus(false);
  },

  async click(event) {
    const key = event.target.closest('[data-key]'), button = event.target.closest('[data-do]');
    if (key) return live.press(key.dataset.key);
    if (!button) return;
    const version = live.state.version, word = button.dataset.do;
    if (word === 'pad') live.pad(document.getElementById('pad').hidden);
    else if (word === 'undo') await live.request('/undo', {version});
    else if (word === 'skip') await live.request('/skip', {version, text: document.querySelector('#entry [name="remark"]').value});
    else if (word === 'unskip') await live.request('/unskip', {version});
    else if (word === 'repeat' || word === 'go-on') await live.request('/repeat', {version, again: word === 'repeat'});
    else if (word === 'remark') {
      const text = document.querySelector('#entry [name="remark"]');
      if (!text.value.trim()) { live.say('Type the remark into its field first.'); text.focus(); return; }
      await live.request('/remark', {version, text: text.value});
    } else if (word === 'diagnose' || word === 'identify') await live.request('/fit', {word});
    else if (word === 'acceptance') await live.request('/acceptance', {keys: [button.closest('[data-result]').dataset.result]});
  },

  pad(open) {
    const pad = document.getElementById('pad');
    if (!pad) return;
    pad.hidden = !open;
    document.querySelector('[data-do="pad"]').setAttribute('aria-expanded', String(open));
  },

  press(key) {
    const inputs = [...document.querySelectorAll('#entry [name="value"]')];
    const input = inputs.includes(live.at) ? live.at : inputs[0];
    if (key === 'back') input.value = input.value.slice(0, -1);
    else if (key === '\u2212') input.value = input.value.startsWith('-') ? input.value.slice(1) : '-' + input.value;
    else input.value += key;
    delete input.dataset.line;
  },
};
document.addEventListener('focusin', event => { if (event.target.name === 'value') live.at = event.target; });
document.addEventListener('input', event => { delete event.target.dataset.line; });
live.start();
