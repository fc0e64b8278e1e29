// Keeps the screen on while the page is in sight and connected: who only watches the robot presses nothing. Browsers allow
// this over https, and on the robot's own machine.
(() => {
  const LOOK_MS = 1000;
  let lock = null;
  let is_asking = false;
  setInterval(async () => {
    const is_wanted = document.visibilityState === "visible" && Boolean(window.socket?.connected);
    if (!is_wanted) lock?.release();
    if (!is_wanted || lock || is_asking) return;
    is_asking = true;
    lock = (await navigator.wakeLock?.request("screen").catch(() => null)) ?? null;
    is_asking = false;
    lock?.addEventListener("release", () => (lock = null)); // as when another tab is shown
  }, LOOK_MS);
})();
