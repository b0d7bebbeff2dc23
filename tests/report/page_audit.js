// What is wrong with the page that is shown, as a list of sentences. WIDTH is the width of the screen in pixels.
((width) => {
  const found = [], LEAST_CONTRAST = 4.5, LEAST_PX = 12, LONG_PX = 6000, SLACK = 0.01;
  document.querySelectorAll("details").forEach(d => { d.open = true; });
  const shown = e => e.checkVisibility({ visibilityProperty: true, opacityProperty: true });
  const name = e => {
    const css = String(e.className.baseVal ?? e.className).split(" ").filter(Boolean).map(c => "." + c).join("");
    return e.tagName.toLowerCase() + css + " `" + e.textContent.trim().slice(0, 40) + "`";
  };

  const root = document.documentElement;
  if (root.scrollWidth > width) found.push(`the document is ${root.scrollWidth} px wide`);

  const brush = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const colour = text => {
    brush.clearRect(0, 0, 1, 1); brush.fillStyle = text; brush.fillRect(0, 0, 1, 1);
    return [...brush.getImageData(0, 0, 1, 1).data];
  };
  const over = (top, under) => [0, 1, 2].map(k => (top[k] * top[3] + under[k] * (255 - top[3])) / 255).concat(255);
  const paper = e => {
    const layers = [];
    for (let n = e; n; n = n.parentElement) layers.unshift(colour(getComputedStyle(n).backgroundColor));
    return layers.reduce((under, top) => over(top, under), [255, 255, 255, 255]);
  };
  // WCAG 2.2, relative luminance and contrast ratio
  const channel = v => v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4;
  const luminance = c => 0.2126 * channel(c[0]) + 0.7152 * channel(c[1]) + 0.0722 * channel(c[2]);
  const contrast = (a, b) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);

  const seen = new Set(), walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let n = walker.nextNode(); n; n = walker.nextNode()) {
    const e = n.parentElement, svg = e.closest("svg"), style = getComputedStyle(e);
    if (!n.textContent.trim() || ["SCRIPT", "STYLE", "TEMPLATE"].includes(e.tagName) || !shown(e)) continue;
    const under = paper(e), ink = over(colour(svg ? style.fill : style.color), under);
    const ratio = contrast(luminance(ink), luminance(under));
    const scale = svg && svg.viewBox.baseVal.width ? svg.getBoundingClientRect().width / svg.viewBox.baseVal.width : 1;
    const px = parseFloat(style.fontSize) * scale;
    const what = [ratio < LEAST_CONTRAST - SLACK ? `contrast ${ratio.toFixed(2)}` : "", px < LEAST_PX - SLACK ? `${px.toFixed(1)} px` : ""];
    if (svg && e.getBoundingClientRect().right > width + 1 && !e.closest(".scroll")) what.push("beyond the edge");
    const words = what.filter(Boolean).join(", ");
    if (words && !seen.has(words)) { seen.add(words); found.push(`${words}: ${name(e)}`); }
  }

  for (const box of document.querySelectorAll("body *")) {
    const scrolls = ["auto", "scroll"].includes(getComputedStyle(box).overflowX);
    if (scrolls && box.tabIndex < 0) found.push(`scrolls, but no key reaches it: ${name(box)}`);
  }
  for (const th of document.querySelectorAll("th:not([scope])")) found.push(`no scope: ${name(th)}`);
  for (const svg of document.querySelectorAll("svg")) {
    if (svg.getAttribute("role") !== "img" || !svg.getAttribute("aria-label")) found.push("a drawing without words");
  }
  const ids = [...document.querySelectorAll("[id]")].map(e => e.id);
  for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) found.push(`id twice: ${id}`);
  if (!document.querySelector("a.skip")) found.push("no skip link");
  for (const a of document.querySelectorAll('a[href^="#"]')) {
    if (!document.getElementById(a.getAttribute("href").slice(1))) found.push(`a link to nowhere: ${name(a)}`);
  }
  if (width > 1000 && root.scrollHeight > LONG_PX && !document.querySelector("nav")) found.push("long, without contents");
  return found;
})(WIDTH)
