/* Numbers and names as text. */

/** A number with about four significant digits; an en dash if it is missing. */
function formatNumber(value) {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1e6 || (size > 0 && size < 1e-3)) return value.toExponential(2).replace(/-/g, "−");
  const digits = size >= 1000 ? 0 : size >= 100 ? 1 : size >= 10 ? 2 : 3;
  return value.toFixed(digits).replace("-", "−");
}

/** A number with its unit. */
function formatValue(value, unit) {
  const text = formatNumber(value);
  return unit && text !== "–" ? `${text} ${unit}` : text;
}

/** A time with milliseconds. */
function formatTime(seconds) {
  return `${seconds.toFixed(3).replace("-", "−")} s`;
}

/** Title of an axis: name and unit. */
function axisTitle(label, unit) {
  return unit ? `${label}, ${unit}` : label;
}
