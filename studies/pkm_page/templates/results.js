document.getElementById('beside')?.addEventListener('submit', event => {
  event.preventDefault();
  const choice = new FormData(event.target);
  if (choice.get('first') !== choice.get('second')) location.href = `/results/${choice.get('first')}/beside/${choice.get('second')}`;
});
document.addEventListener('click', async event => {
  const button = event.target.closest('[data-do="open"]');
  if (!button) return;
  document.getElementById('said').textContent = 'Opens …';
  const answer = await send('/open', {keys: [button.dataset.study]});
  if (answer.status === 200) location.href = '/';
  else document.getElementById('said').textContent = answer.error;
});
