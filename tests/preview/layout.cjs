// What is wrong with how the page lies, as sentences: run in the page. Nothing may stand over another thing, be cut, be broken in
// a word's middle, or stick out.
module.exports = () => {
  const found = [];
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth) found.push(`the page is ${wide} wide`);
  const seen = (one) => one.checkVisibility() && one.getClientRects().length > 0;
  const name = (one) => `${one.tagName.toLowerCase()}${one.id ? "#" + one.id : ""} "${(one.textContent || "").trim().slice(0, 24)}"`;
  // What a person reads or presses.
  const leaves = [...document.querySelectorAll("button, select, input, output, dt, dd, label, p, pre, h2, .name, .value, .badge, .bar, .region, #view, #curves, #picture, #why, header b")].filter(seen);
  for (const one of leaves) {
    if (one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0 && !/^(INPUT|CANVAS)$/.test(one.tagName)) found.push(`cut: ${name(one)}`);
    const { left, right } = one.getBoundingClientRect();
    if (left < -1 || right > innerWidth + 1) found.push(`outside: ${name(one)}`);
    // A word that is broken in its middle.
    const texts = document.createTreeWalker(one, NodeFilter.SHOW_TEXT);
    for (let text = texts.nextNode(); text; text = texts.nextNode()) {
      for (const word of text.data.matchAll(/[A-Za-z]+/g)) {
        const range = document.createRange();
        range.setStart(text, word.index); range.setEnd(text, word.index + word[0].length);
        const tops = new Set([...range.getClientRects()].map((box) => Math.round(box.top)));
        if (tops.size > 1) found.push(`broken: ${word[0]} in ${name(one)}`);
      }
    }
  }
  leaves.forEach((a, k) => leaves.slice(k + 1).forEach((b) => {
    if (a.contains(b) || b.contains(a)) return;
    const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
    const across = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const down = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (across > 1 && down > 1 && p.width && q.width) {
      // What scrolls under the edge of its panel is not over its neighbours.
      const panel = (one) => one.closest("aside");
      if (panel(a) === panel(b)) found.push(`overlap: ${name(a)} and ${name(b)}`);
    }
  }));
  return found;
};
