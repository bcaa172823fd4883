document.getElementById('beside')?.addEventListener('submit', event => {
  event.preventDefault();
  const choice = new FormData(event.target);
  if (choice.get('first') !== choice.get('second')) location.href = `/results/${choice.get('first')}/beside/${choice.get('second')}`;
});
