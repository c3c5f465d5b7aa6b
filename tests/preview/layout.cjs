// What is wrong with a page, as sentences: how it lies, what letters can be read, what is empty. Of every page of mien, at three
// widths, light and dark (`judge`); the first two are run in the page.
const path = require("node:path");

// Nothing may stand over another thing, be cut, be broken in a word's middle, or stick out.
function layout() {
  const found = [];
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth) found.push(`the page is ${wide} wide`);
  const seen = (one) => one.checkVisibility() && one.getClientRects().length > 0;
  const name = (one) => `${one.tagName.toLowerCase()}${one.id ? "#" + one.id : ""} "${(one.textContent || "").trim().slice(0, 24)}"`;
  // What a person reads or presses.
  const leaves = [...document.querySelectorAll("button, select, input, output, dt, dd, label, p, pre, h2, h3, figcaption, .legend li, .name, .value, .badge, .bar, .region, #view, #curves, #picture, #depth, #why, .chart canvas, header b, header h1")].filter(seen);
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
    // A name plate lies on its view.
    if (a.closest(".view") && a.closest(".view") === b.closest(".view")) return;
    const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
    const across = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const down = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (across > 1 && down > 1 && p.width && q.width) {
      // What scrolls under the edge of its panel is not over its neighbours, nor what stays in sight over what scrolls.
      const panel = (one) => one.closest("aside, #controls, #seen");
      if (panel(a) === panel(b)) found.push(`overlap: ${name(a)} and ${name(b)}`);
    }
  }));
  return found;
}

// Letters below 4.5 : 1 (WCAG 2.2, 1.4.3), with what is behind them as the styles say; letters in drawings by the colour they
// are drawn in.
function contrast() {
  const pen = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    pen.clearRect(0, 0, 1, 1);
    pen.fillStyle = colour;
    pen.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = pen.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = ([r, g, b, a], under) => [r, g, b].map((c, k) => c * a + under[k] * (1 - a));
  const light = (colour) => {
    const [r, g, b] = colour.map((c) => { const v = c / 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (a, b) => { const [p, q] = [light(a), light(b)].sort((x, y) => y - x); return (p + 0.05) / (q + 0.05); };
  const behind = (one) => {
    if (!one) return [255, 255, 255];
    const own = rgba(getComputedStyle(one).backgroundColor);
    return own[3] === 1 ? own.slice(0, 3) : over(own, behind(one.parentElement));
  };
  // Of an element that is partly seen through, with all around it.
  const opacity = (one) => (one ? Number(getComputedStyle(one).opacity) * opacity(one.parentElement) : 1);
  const found = new Map();
  const judge = (one, ink, ground, text) => {
    const [r, g, b, a] = rgba(ink);
    const value = ratio(over([r, g, b, a * opacity(one)], ground), ground);
    if (value < 4.49) found.set(`${value.toFixed(2)} : 1 "${text.trim().slice(0, 24)}" (${one.tagName.toLowerCase()}${one.id ? "#" + one.id : ""}.${one.getAttribute("class") ?? ""})`, value);
    return value;
  };
  let count = 0;
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = texts.nextNode(); text; text = texts.nextNode()) {
    const one = text.parentElement;
    if (!text.data.trim() || /^(SCRIPT|STYLE|OPTION|TITLE)$/.test(one.tagName) || !one.checkVisibility({ checkVisibilityCSS: true }) || !one.getClientRects().length) continue;
    count += 1;
    const style = getComputedStyle(one);
    if (one instanceof SVGElement && one.ownerSVGElement.id === "points") judge(one, style.fill, rgba(style.stroke).slice(0, 3), text.data);
    // Plots of plotters are drawn on white paper.
    else if (one instanceof SVGElement) judge(one, style.fill, [255, 255, 255], text.data);
    else judge(one, style.color, behind(one), text.data);
  }
  for (const one of document.querySelectorAll("input:not([type=range], [type=checkbox], [type=file]), select")) {
    if (one.checkVisibility()) judge(one, getComputedStyle(one).color, behind(one), one.value || "input");
  }
  for (const one of document.querySelectorAll("canvas#curves, .chart canvas")) {
    if (one.checkVisibility()) judge(one, getComputedStyle(one).getPropertyValue("--dim"), behind(one), "axis");
  }
  // Lines of curves are no letters: 3 : 1 (1.4.11).
  for (const one of document.querySelectorAll(".legend i")) {
    if (one.checkVisibility() && ratio(rgba(getComputedStyle(one).borderTopColor).slice(0, 3), behind(one)) < 3) found.set(`a curve below 3 : 1: ${one.parentElement.textContent}`, 3);
  }
  return { count, found: [...found.keys()] };
}

// Whether a panel shows nothing: fewer than eight colours in what is seen of it.
async function isEmpty(page, selector) {
  const panel = page.locator(selector).first();
  if (!(await panel.count()) || !(await panel.isVisible())) return true;
  const shot = await panel.screenshot({ timeout: 180000 });
  return page.evaluate(async (base64) => {
    const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))]));
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const pen = canvas.getContext("2d");
    pen.drawImage(bitmap, 0, 0);
    const { data } = pen.getImageData(0, 0, bitmap.width, bitmap.height);
    const colours = new Set();
    for (let k = 0; k < data.length; k += 4) colours.add((data[k] >> 3) * 1024 + (data[k + 1] >> 3) * 32 + (data[k + 2] >> 3));
    return colours.size < 8;
  }, shot.toString("base64"));
}

const SIZES = [[390, 844], [1024, 768], [1600, 1000]];

// Judges a page at three widths, light and dark, and takes its pictures. A CI run draws with the processor and judges every width
// in one scheme; EVERY=1 judges all. `panels` are what must not be empty; `tabs` is what else
// is to be pressed and judged.
async function judge(page, name, { check, shots, panels = [], tabs = [] }) {
  for (const [width, height] of SIZES) {
    const schemes = process.env.EVERY ? ["light", "dark"] : [width === 1024 ? "light" : "dark"];
    for (const colorScheme of schemes) {
      await page.setViewportSize({ width, height });
      await page.emulateMedia({ colorScheme });
      await page.evaluate(() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn))));
      await page.waitForTimeout(400);
      await page.evaluate(() => scrollTo(0, 0));
      const at = `${name}-${width}-${colorScheme}`;
      await page.screenshot({ path: path.join(shots, `${at}.png`), fullPage: width < 760, timeout: 180000 });
      const empty = [];
      for (const panel of panels) if (await isEmpty(page, panel)) empty.push(panel);
      check(`${at}: no panel is empty`, !empty.length, empty.join(", "));
      // What is drawn all the time stands still meanwhile.
      await page.evaluate(() => {
        window.draws = window.requestAnimationFrame;
        window.requestAnimationFrame = (next) => { window.held = next; };
      });
      const [wrong, pale] = [[], []];
      let letters = 0;
      for (const tab of [null, ...tabs]) {
        if (tab) await page.click(tab);
        wrong.push(...(await page.evaluate(layout)).map((what) => (tab ? `${tab}: ${what}` : what)));
        const { count, found } = await page.evaluate(contrast);
        letters += count;
        pale.push(...found);
      }
      await page.evaluate(() => {
        window.requestAnimationFrame = window.draws;
        if (window.held) requestAnimationFrame(window.held);
      });
      check(`${at}: nothing is cut or covered`, !wrong.length, wrong.slice(0, 5).join(" | "));
      check(`${at}: letters can be read`, letters > 10 && !pale.length, pale.slice(0, 5).join(" | ") || `${letters} texts at 4.5 : 1 or more`);
    }
  }
  await page.emulateMedia({ colorScheme: "dark" });
}

module.exports = { layout, contrast, isEmpty, judge };
