/* What scrolls sideways can be reached, and so scrolled, by keyboard. */
const reachable = () => document.querySelectorAll(".md-typeset pre > code, .md-typeset__scrollwrap").forEach((one) => {
  if (one.scrollWidth > one.clientWidth) one.tabIndex = 0;
});
window.addEventListener("load", reachable);
window.addEventListener("resize", reachable);
