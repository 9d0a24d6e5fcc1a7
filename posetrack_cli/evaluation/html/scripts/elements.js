/* Creation of HTML and SVG elements; text is never parsed as HTML. */

const SVG_NAMESPACE = "http://www.w3.org/2000/svg";

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

function makeElement(name, attributes = {}, ...children) {
  return fill(document.createElement(name), attributes, children);
}

function makeSvg(name, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG_NAMESPACE, name), attributes, children);
}

/** The CSS class with the colour of a result. */
function colourClass(index) {
  return `colour-${index % 6}`;
}

/** Dash pattern that distinguishes results with the same colour. */
function dashes(index) {
  return [null, "7 3", "2 3", "8 3 2 3"][Math.floor(index / 6) % 4];
}

/** With many results, all but the selected one are faded. */
function stepsBack(store, result) {
  return store.results.length > 6 && result !== store.result;
}

/** Legend sample of a line, or of an area of kind band, lost or gap. */
function makeSwatch(kind, index) {
  const isArea = ["band", "lost", "gap"].includes(kind);
  const sample = isArea
    ? makeSvg("rect", { class: kind, width: 22, height: 10 })
    : makeSvg("line", { class: `line ${kind}`, x1: 1, x2: 21, y1: 5, y2: 5, "stroke-dasharray": kind ? null : dashes(index) });
  return makeSvg("svg", { class: `swatch ${colourClass(index)}`, "aria-hidden": "true" }, sample);
}

/** A paragraph about missing content. */
function makeMissing(text) {
  return makeElement("p", { class: "missing" }, text);
}
