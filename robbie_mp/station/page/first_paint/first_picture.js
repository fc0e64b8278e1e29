// Fulfilled when the emergency stop is there and, if the camera to drive by is in sight, its first picture. What the page
// does not need before is loaded then.
window.first_picture = new Promise((done) => {
  const LIMIT_MS = 5000;
  let begin_ms = Infinity;
  const timer = setInterval(() => {
    if (!document.getElementById("emergency-stop-state")) return;
    begin_ms = Math.min(begin_ms, performance.now());
    const pictures = [...document.querySelectorAll(".camera-picture img")];
    if (pictures.some((one) => !one.naturalWidth) && performance.now() - begin_ms < LIMIT_MS) return;
    clearInterval(timer);
    done();
  }, 100);
});
