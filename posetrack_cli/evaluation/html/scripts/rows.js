/* Tables with a row per result: sortable by column, filterable by name. */

const BY_NAME = new Intl.Collator("en", { numeric: true });

/** Sort key of a row: a number, null if it is missing, or a name. */
function sortValue(row, column, kind) {
  const cell = row.cells[column];
  if (kind === "text") return cell.textContent;
  return cell.dataset.value === undefined ? null : Number(cell.dataset.value);
}

/** Sorted rows; those without a value come last in both directions. */
function sortedRows(rows, column, kind, descending) {
  const keyed = rows.map((row) => [sortValue(row, column, kind), row]);
  const known = keyed.filter(([value]) => value !== null);
  const unknown = keyed.filter(([value]) => value === null);
  const compare = kind === "text" ? BY_NAME.compare : (a, b) => a - b;
  known.sort(([a], [b]) => (descending ? compare(b, a) : compare(a, b)));
  return [...known, ...unknown].map(([, row]) => row);
}

function makeSortable(table) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "sort";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const before = head.getAttribute("aria-sort");
      const descending = before ? before === "ascending" : head.dataset.kind !== "text";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", descending ? "descending" : "ascending");
      body.append(...sortedRows([...body.rows], column, head.dataset.kind, descending));
    });
  });
}

function makeFilter(bar, table) {
  const search = bar.querySelector(".name-filter");
  const failed = bar.querySelector(".only-failed");
  const count = bar.querySelector(".shown-count");
  const rows = [...table.tBodies[0].rows];
  const names = new Map(rows.map((row) => [row, row.cells[0].textContent.toLowerCase()]));
  const apply = () => {
    const wanted = search.value.toLowerCase();
    let shown = 0;
    rows.forEach((row) => {
      row.hidden = !names.get(row).includes(wanted) || (failed?.checked && !row.classList.contains("failed"));
      if (!row.hidden) shown += 1;
    });
    count.textContent = `${shown} of ${rows.length} results shown`;
  };
  search.addEventListener("input", apply);
  failed?.addEventListener("change", apply);
  bar.hidden = false;
  apply();
}

document.querySelectorAll("table.rows").forEach((table) => {
  makeSortable(table);
  makeFilter(table.closest("section").querySelector(".filter"), table);
});
