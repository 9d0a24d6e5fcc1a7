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

function makeSwatch(kind, index) {
  return makeElement("span", { class: `swatch ${kind} ${index === undefined ? "" : colourClass(index)}`, "aria-hidden": "true" });
}

/** A paragraph that says what is missing and why. */
function makeMissing(text) {
  return makeElement("p", { class: "missing" }, text);
}
