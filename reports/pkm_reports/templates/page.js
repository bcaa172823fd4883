// The page around the views: light or dark, tables as CSV, tables that scroll say so.
const page = {
  // Text of an element as a program reads it: plain minus and space.
  plain(node) {
    return node.textContent.replace(/\u2212/g, '-').replace(/[\u00a0\s]+/g, ' ').trim();
  },

  csv(table) {
    const rows = [...table.rows].map(row => [...row.cells].map(cell => {
      const words = page.plain(cell);
      return /[",\n]/.test(words) ? '"' + words.replace(/"/g, '""') + '"' : words;
    }).join(','));
    return rows.join('\r\n') + '\r\n';
  },

  save(name, words) {
    const link = document.createElement('a');
    // The mark at the start tells spreadsheets that the text is UTF-8.
    link.href = URL.createObjectURL(new Blob(['\ufeff', words], {type: 'text/csv'}));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  },

  exports() {
    const study = page.plain(document.querySelector('nav p')).replace(/[^\w-]+/g, '_');
    for (const figure of document.querySelectorAll('figure.table')) {
      const label = figure.dataset.name;
      const button = document.createElement('button');
      button.type = 'button';
      button.className = 'export';
      button.textContent = 'CSV';
      button.setAttribute('aria-label', label + ' as CSV');
      const name = study + '_' + label.toLowerCase().replace(' ', '_') + '.csv';
      button.addEventListener('click', () => page.save(name, page.csv(figure.querySelector('table'))));
      figure.prepend(button);
    }
  },

  // Below each box that is wider than the page: that it scrolls sideways.
  hints() {
    for (const box of document.querySelectorAll('.scroll, .pan')) {
      const hint = box.nextElementSibling?.className === 'scrolls' ? box.nextElementSibling : null;
      const scrolls = box.scrollWidth > box.clientWidth + 2;
      if (scrolls && !hint) {
        const words = document.createElement('p');
        words.className = 'scrolls';
        words.textContent = '\u2194 scrolls sideways';
        box.after(words);
      } else if (!scrolls && hint) hint.remove();
      // A box that does not scroll needs no stop of the tab key.
      const tall = box.scrollHeight > box.clientHeight + 2;
      if (scrolls || tall) box.tabIndex = 0; else box.removeAttribute('tabindex');
    }
  },

  theme() {
    const root = document.documentElement, button = document.getElementById('theme');
    const dark = () => root.dataset.theme ? root.dataset.theme === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
    const name = () => { button.textContent = dark() ? 'Light' : 'Dark'; };
    button.hidden = false;
    name();
    button.addEventListener('click', () => {
      root.dataset.theme = dark() ? 'light' : 'dark';
      name();
      document.dispatchEvent(new Event('theme'));
    });
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
      name();
      document.dispatchEvent(new Event('theme'));
    });
  },

  // A link opens the chapter that it names; on paper all are open.
  unfold() {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const chapter = target?.closest('details.chapter');
    if (chapter) { chapter.open = true; target.scrollIntoView(); }
  },

  colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim();
  },
};

// Where there is room beside the text, the contents are open.
const wide = matchMedia('(min-width: 72rem)');
const contents = () => { document.getElementById('contents').open = wide.matches; };
wide.addEventListener('change', contents);
contents();
addEventListener('hashchange', page.unfold);
addEventListener('beforeprint', () => {
  for (const chapter of document.querySelectorAll('details.chapter')) chapter.open = true;
});
page.theme();
page.unfold();
page.exports();
page.hints();
addEventListener('resize', page.hints);
addEventListener('load', page.hints);
