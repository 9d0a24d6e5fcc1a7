/* Making elements of HTML and SVG; text is always set as text, never parsed. */

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

/** The class that gives an element the colour of a result. */
function colourClass(index) {
  return `colour-${index % 6}`;
}

/** Dashes tell results apart that share a colour. */
function dashes(index) {
  return [null, "7 3", "2 3", "8 3 2 3"][Math.floor(index / 6) % 4];
}

/** Many results are too many colours: all but the one shown in detail step back. */
function stepsBack(store, result) {
  return store.results.length > 6 && result !== store.result;
}

/** A sample of a line, or of an area that is called band, lost or gap. */
function makeSwatch(kind, index) {
  const isArea = ["band", "lost", "gap"].includes(kind);
  const sample = isArea
    ? makeSvg("rect", { class: kind, width: 22, height: 10 })
    : makeSvg("line", { class: `line ${kind}`, x1: 1, x2: 21, y1: 5, y2: 5, "stroke-dasharray": kind ? null : dashes(index) });
  return makeSvg("svg", { class: `swatch ${colourClass(index)}`, "aria-hidden": "true" }, sample);
}

/** A paragraph that says what is missing and why. */
function makeMissing(text) {
  return makeElement("p", { class: "missing" }, text);
}
