/* Lines and bands as SVG path data. */

/** First and last index of the points in a domain, plus one neighbour on each side. */
function visibleRange(x, [low, high]) {
  let first = 0, last = x.length - 1;
  while (first < last && x[first + 1] < low) first++;
  while (last > first && x[last - 1] > high) last--;
  return [first, last];
}

/**
 * Runs [first, last] of indices without interruption. Lines are interrupted at missing values and at visible
 * gaps. `gaps` are sorted [from, to] pairs.
 */
function unbrokenRuns(x, y, [first, last], gaps) {
  const runs = [];
  let start = -1, gap = 0;
  for (let i = first; i <= last; i++) {
    if (!Number.isFinite(y[i])) {
      if (start >= 0) runs.push([start, i - 1]);
      start = -1;
      continue;
    }
    while (gap < gaps.length && gaps[gap][1] <= x[i] + 1e-9) {
      if (start >= 0 && i > start && gaps[gap][0] >= x[i - 1] - 1e-9) {
        runs.push([start, i - 1]);
        start = i;
      }
      gap++;
    }
    if (start < 0) start = i;
  }
  if (start >= 0) runs.push([start, last]);
  return runs;
}

/** Path of a line; a run of one point is drawn as a dot. */
function linePath(xs, ys, x, y, runs) {
  const parts = [];
  for (const [first, last] of runs) {
    let command = "M";
    for (let i = first; i <= last; i++) {
      parts.push(`${command}${xs.at(x[i]).toFixed(1)} ${ys.at(y[i]).toFixed(1)}`);
      command = "L";
    }
    if (first === last) parts.push("h0.01");
  }
  return parts.join("");
}

/** Path of the area between y - half and y + half. */
function bandPath(xs, ys, x, y, half, runs) {
  const parts = [];
  for (const [first, last] of runs) {
    const upper = [], lower = [];
    for (let i = first; i <= last; i++) {
      if (!Number.isFinite(half[i])) continue;
      const at = xs.at(x[i]).toFixed(1);
      upper.push(`${at} ${ys.at(y[i] + half[i]).toFixed(1)}`);
      lower.push(`${at} ${ys.at(y[i] - half[i]).toFixed(1)}`);
    }
    if (upper.length) parts.push(`M${upper.join("L")}L${lower.reverse().join("L")}Z`);
  }
  return parts.join("");
}

/** Minimum and maximum of the visible part of some lines. */
function valueExtent(lines, domain) {
  let low = Infinity, high = -Infinity;
  for (const { x, y } of lines) {
    const [first, last] = visibleRange(x, domain);
    for (let i = first; i <= last; i++) {
      if (y[i] < low && Number.isFinite(y[i])) low = y[i];
      if (y[i] > high && Number.isFinite(y[i])) high = y[i];
    }
  }
  return [low, high];
}

/** Median of the finite half widths of the bands, used to reserve space for them. */
function typicalHalfWidth(lines) {
  const widths = lines.flatMap((line) => (line.half ? Array.from(line.half).filter(Number.isFinite) : []));
  widths.sort((a, b) => a - b);
  return widths.length ? widths[widths.length >> 1] : 0;
}
