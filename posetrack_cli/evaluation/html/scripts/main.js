/* Entry point of the page. */

function showReport() {
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const results = data.results.map((result, index) => new Result(result, index, data.tickSeconds));
  const store = new Store(results);
  store.sharedTime = data.sharedTime;
  store.pools = data.pools;
  document.querySelectorAll(".scripted").forEach((one) => { one.hidden = false; });
  const find = (id) => document.getElementById(id);
  new OverTime(store, find("quantity-choice"), find("over-time-plot"));
  showCurve(store, find("curve-choice"), find("curve-plot"));
  if (results.length && results.every((result) => result.subject === "head")) find("parts-title").textContent = "Error by point";
  new Parts(store, find("parts-plot"));
  showHonesty(store, find("reliability-plot"), find("roc-plot"));
  new Trajectories(store, find("component-choice"), find("trajectory-legend"), find("trajectory-plots"));
  new Player(store, find("scene-view"), find("scene-remark"));
  showGallery(store);
  showChooser(store, find("chooser"), find("result-choice"));
  preparePrinting(store);
}

/** Selection of the result for trajectories, 3D view and pictures. */
function showChooser(store, bar, select) {
  if (store.results.length < 2) return;
  bar.hidden = false;
  select.append(...store.results.map((result) => makeElement("option", { value: result.index }, result.name)));
  select.addEventListener("change", () => store.set("result", store.results[Number(select.value)]));
}

/** Pictures of the selected result, with buttons that show the frame in the 3D view. */
function showGallery(store) {
  const groups = [...document.querySelectorAll(".gallery-of")];
  const choose = () => groups.forEach((group) => { group.hidden = Number(group.dataset.result) !== store.result?.index; });
  groups.forEach((group) => group.querySelectorAll("figure").forEach((figure) => linkFigure(store, group, figure)));
  store.on("result", choose);
  choose();
}

function linkFigure(store, group, figure) {
  const result = store.results[Number(group.dataset.result)];
  const button = figure.querySelector(".jump");
  if (!result.scene) return;
  button.hidden = false;
  figure.classList.add("jumps");
  const jump = () => {
    store.set("now", result.pictures[Number(button.dataset.picture)]);
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    document.getElementById("scene").scrollIntoView({ behavior: calm ? "auto" : "smooth", block: "nearest" });
  };
  button.addEventListener("click", jump);
  figure.querySelector("img").addEventListener("click", jump);
}

/** Prints with light colours and all sections expanded. */
function preparePrinting(store) {
  const folded = [...document.querySelectorAll("details")];
  let opened = [];
  const redraw = () => store.listeners.result.forEach((listener) => listener(store.result));
  window.addEventListener("beforeprint", () => {
    opened = folded.filter((one) => !one.open);
    opened.forEach((one) => { one.open = true; });
    document.documentElement.classList.add("printing");
    redraw();
  });
  window.addEventListener("afterprint", () => {
    opened.forEach((one) => { one.open = false; });
    document.documentElement.classList.remove("printing");
    redraw();
  });
}

showReport();
