// WCAG 2.1: 1.4.3 (text 4.5:1, 3:1 from 24 px or bold 18.66 px), 1.4.11 (borders of controls 3:1). What is seen is composed: colours
// with alpha over what is under them, and opacity of all that is around. Images, canvases and what is disabled are left out.
() => {
  const parsed = (css) => { const c = (css.match(/[\d.]+/g) || []).map(Number); return c.length > 3 ? c : [...c, 1]; };
  const srgb = (css) => css.startsWith("color(srgb") ? parsed(css.slice(10)).map((x, i) => (i < 3 ? 255 * x : x)) : parsed(css);
  const over = ([r, g, b, a], under) => [r, g, b].map((x, i) => x * a + under[i] * (1 - a));
  const light = (c) => { const [r, g, b] = c.map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ratio = (a, b) => { const [x, y] = [light(a), light(b)].sort((m, n) => n - m); return (x + 0.05) / (y + 0.05); };
  const chain = (e) => { const all = []; for (; e; e = e.parentElement) all.unshift(e); return all; };
  const behind = (e, own) => { // the colour that what is drawn in e stands on; null over images
    let back = [255, 255, 255];
    for (const each of chain(own ? e : e.parentElement)) {
      if (each.matches(".frame-canvas, .studio-view, .nicegui-echart")) return null;
      const style = getComputedStyle(each);
      back = over(srgb(style.backgroundColor), back);
    }
    return back;
  };
  const opacity = (e) => chain(e).reduce((all, each) => all * +getComputedStyle(each).opacity, 1);
  const seen = (e) => { const box = e.getBoundingClientRect(); const style = getComputedStyle(e);
    return box.width > 1 && box.height > 1 && style.visibility !== "hidden" && e.checkVisibility({ opacityProperty: true }); };
  const named = (e) => `${e.tagName.toLowerCase()}.${[...e.classList].slice(0, 4).join(".")} "${(e.innerText || "").slice(0, 30)}"`;
  const bad = new Set(); let count = 0;
  const hold = (e, colour, back, least, what) => {
    if (back === null) return;
    const [r, g, b, a] = srgb(colour);
    count += 1;
    const is = ratio(over([r, g, b, a * opacity(e)], back), back);
    if (is < least - 0.01) bad.add(`${what} ${is.toFixed(2)} < ${least}: ${named(e)}`);
  };
  const words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (words.nextNode()) {
    const e = words.currentNode.parentElement;
    if (!words.currentNode.data.trim() || !seen(e) || e.closest(".disabled, [disabled], [aria-disabled=true], script, style, noscript")) continue;
    const style = getComputedStyle(e), size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && +style.fontWeight >= 700);
    const icon = e.closest(".q-icon, i");
    hold(e, style.color, behind(e, true), large || icon ? 3 : 4.5, icon ? "icon" : "text");
  }
  for (const e of document.querySelectorAll("input, textarea")) {
    if (!seen(e) || e.closest(".disabled") || e.type === "file") continue;
    if (e.value) hold(e, getComputedStyle(e).color, behind(e, true), 4.5, "value");
  }
  for (const e of document.querySelectorAll(".q-field--outlined .q-field__control")) {
    if (!seen(e) || e.closest(".disabled")) continue;
    hold(e, getComputedStyle(e, "::before").borderTopColor, behind(e, false), 3, "border");
  }
  for (const e of document.querySelectorAll(".q-checkbox__bg, .q-slider__track")) {
    if (!seen(e) || e.closest(".disabled")) continue;
    const style = getComputedStyle(e);
    hold(e, e.matches(".q-slider__track") ? style.backgroundColor : style.borderTopColor, behind(e, false), 3, "control");
  }
  return [count, [...bad]];
}
