// Quasar lets a part of its lists take the focus that is no option, where screen readers expect options only.
addEventListener("DOMContentLoaded", () => {
  const clean = () => {
    for (const one of document.querySelectorAll("[role=listbox] > .q-virtual-scroll__content[tabindex]")) one.removeAttribute("tabindex");
  };
  // A list is added to the body when it opens, and filled right after.
  new MutationObserver(() => requestAnimationFrame(clean)).observe(document.body, { childList: true });
});
