// Requests of the page, and the buttons on cards of results.
const send = async (path, values) => {
  const answer = await fetch(path, {method: 'POST', headers: {'Content-Type': 'application/json'}, body: JSON.stringify(values)});
  const text = await answer.text();
  try { return {status: answer.status, ...JSON.parse(text)}; } catch { return {status: answer.status, error: text}; }
};
const compensate = async card => {
  const said = card.querySelector('.said');
  said.textContent = 'Writes …';
  const answer = await send('/compensation', {keys: [card.dataset.result], word: card.querySelector('[data-format]').value});
  if (answer.error) { said.textContent = answer.error; return; }
  for (const [name, words] of Object.entries(answer.files)) {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(new Blob([words], {type: 'text/plain'}));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
  said.textContent = [...Object.keys(answer.files), ...answer.sentences].join('; ') + '.';
};
document.addEventListener('click', event => {
  const button = event.target.closest('[data-do="compensation"]');
  if (button) compensate(button.closest('[data-result]'));
});
const judge = async (card, file) => {
  const said = card.querySelector('.said');
  said.textContent = 'Judges …';
  const answer = await send('/judge', {key: card.dataset.result, text: await file.text()});
  said.textContent = answer.error || answer.sentences.join(' ');
};
document.addEventListener('change', event => {
  const input = event.target.closest('[data-judge]');
  if (input && input.files.length) judge(input.closest('[data-result]'), input.files[0]);
});
