// The emergency stop and its state. It has a separate connection (stop_connection.py). It keeps a press, even when the
// page reloads, and names it in every question until the robot answers that the press is settled.
//
// The page must not be left while the server does not answer: the browser would show an error page, which has no button
// and sends nothing. So a script that reloads the page has to wait until the server answers.
export default {
  template: `<div style="position: absolute">
    <Teleport to="body">
      <div v-if="has_ended || is_lost || is_page_lost" id="link-lost" role="alert">
        <div v-if="has_ended" id="station-ended" class="is-end">No connection to the robot: its operator station has ended in
          order, as at the end of a run. What this page shows is its last state.</div>
        <div v-else>No connection to the robot for {{ Math.max(lost_s, page_lost_s) }} s. What this page shows is old.
          <div id="link-refused">{{ refusal }}</div></div>
      </div>
      <div class="emergency-stop">
        <div :class="shown.look">
          <span class="state" id="emergency-stop-state" role="status">{{ shown.state }}</span>
          <span class="detail" id="emergency-stop-detail" :title="shown.detail">{{ shown.detail }}</span>
        </div>
        <button id="emergency-stop" type="button" aria-keyshortcuts="Escape" title="Stop the robot: Escape"
          @pointerdown.stop="press" @mousedown.prevent @click.stop="click">EMERGENCY STOP</button>
      </div>
    </Teleport></div>`,
  data() {
    // now_ms and heard_ms are times of performance.now(): now, and of the last answered question.
    // page_ms: when the connection of the rest of the page was last open.
    const now_ms = performance.now();
    return { now_ms, heard_ms: now_ms, page_ms: now_ms, answer: null, has_ended: false, refusal: "", kept: kept_press(KEPT),
      kept_all: kept_press(KEPT_ALL) };
  },
  mounted() {
    this.unanswered = []; // times of the questions without an answer
    this.trip_ms = 0;
    this.on_key = (event) => {
      if (event.key === "Escape" && !event.repeat && !this.only_closes_a_menu()) this.press();
    };
    // Handle the key before any dialog or menu does.
    addEventListener("keydown", this.on_key, { capture: true });
    this.on_sight = () => this.beat();
    document.addEventListener("visibilitychange", this.on_sight);
    this.on_leave = (event) => {
      if (event.navigationType !== "reload" || event.userInitiated || !event.cancelable || this.may_leave) return;
      event.preventDefault();
      this.leave_when_answered();
    };
    window.navigation?.addEventListener("navigate", this.on_leave);
    addEventListener("robbie-stop-all", this.press_all);
    this.open();
    this.timer = setInterval(() => this.beat(), BEAT_MS);
    this.asker = setInterval(() => this.ask_why(), ASK_WHY_MS);
  },
  unmounted() {
    removeEventListener("keydown", this.on_key, { capture: true });
    document.removeEventListener("visibilitychange", this.on_sight);
    window.navigation?.removeEventListener("navigate", this.on_leave);
    removeEventListener("robbie-stop-all", this.press_all);
    clearInterval(this.timer);
    clearInterval(this.asker);
    this.shut();
  },
  computed: {
    is_lost() {
      return this.now_ms - this.heard_ms > LOST_MS;
    },
    lost_s() {
      return Math.floor((this.now_ms - this.heard_ms) / 1000);
    },
    is_page_lost() {
      return this.now_ms - this.page_ms > LOST_MS;
    },
    // Whether the station has the press that stops all robots.
    is_at_all() {
      return this.kept_all !== null && this.answer?.press_all === this.kept_all.name;
    },
    page_lost_s() {
      return Math.floor((this.now_ms - this.page_ms) / 1000);
    },
    shown() {
      const { answer } = this, kept = this.kept ?? (this.is_at_all ? null : this.kept_all);
      const before = !answer || answer.engaged === null ? "unknown" : answer.engaged ? "STOPPED" : "ready";
      if (kept || (answer && answer.waits_s !== null)) return this.shown_while_pending();
      if (this.is_lost) return { state: "no link", look: "", detail: `for ${this.lost_s} s; before: ${before}` };
      if (!answer) return { state: "connecting", look: "", detail: "" };
      if (answer.is_of_log)
        return { state: `log${before === "unknown" ? "" : `: ${before}`}`, look: "", detail: "no robot is connected" };
      if (answer.age_s === null) return { state: "base silent", look: "", detail: "it has said nothing yet" };
      if (answer.age_s > STALE_S)
        return { state: "base silent", look: "", detail: `for ${Math.floor(answer.age_s)} s; before: ${before}` };
      if (answer.engaged) return { state: "STOPPED", look: "is-stopped", detail: answer.reason };
      return { state: "ready", look: "is-ready", detail: "" };
    },
  },
  methods: {
    shown_while_pending() {
      const { answer } = this, kept = this.kept ?? (this.is_at_all ? null : this.kept_all);
      const look = "is-pending";
      const is_at_robot = !kept || (answer && answer.fate && answer.press === kept.name);
      if (!is_at_robot || this.is_lost) {
        const age_ms = kept ? performance.timeOrigin + this.now_ms - kept.pressed_ms : Infinity;
        if (age_ms < SOON_MS) return { state: "stopping …", look, detail: "" };
        const detail = `it is kept, and sent first; pressed ${Math.max(0, Math.floor(age_ms / 1000))} s ago`;
        if (kept && !is_at_robot) return { state: "NOT DELIVERED", look, detail };
      } else if (answer.waits_s === null || answer.waits_s * 1000 < SOON_MS)
        return { state: "stopping …", look, detail: "" };
      const detail = `the base does not answer; repeated for ${Math.floor(answer.waits_s ?? 0)} s`;
      return { state: "NOT CONFIRMED", look, detail };
    },
    // Whether Escape closes an open menu, or a card that has the focus, as in any program. If it is still open next time,
    // Escape stops the robot.
    only_closes_a_menu() {
      const menu = document.querySelector(".q-menu, .closes-with-escape:focus-within");
      const is_new = menu !== null && menu !== this.spared;
      this.spared = menu;
      return is_new;
    },
    click(event) {
      if (event.detail === 0) this.press(); // by the keyboard; a pointer has pressed already when it went down
    },
    press() {
      this.kept = { name: new_name(), pressed_ms: performance.timeOrigin + performance.now() };
      sessionStorage.setItem(KEPT, JSON.stringify(this.kept));
      this.ask();
    },
    // All robots of the team. The press is kept until each of them has confirmed it.
    press_all() {
      this.kept_all = { name: new_name(), pressed_ms: performance.timeOrigin + performance.now(), settled: [], reached: [] };
      this.keep_all();
      this.ask();
      this.tell_robots();
    },
    keep_all() {
      if (this.kept_all) sessionStorage.setItem(KEPT_ALL, JSON.stringify(this.kept_all));
      else sessionStorage.removeItem(KEPT_ALL);
    },
    hear_all({ press_all, robots }) {
      if (!this.kept_all || press_all !== this.kept_all.name || !robots) return;
      const named = (those) => those.map((one) => one.robot);
      const settled = named(robots.filter((one) => SETTLED.includes(one.fate)));
      this.kept_all.settled = [...new Set([...this.kept_all.settled, ...settled])];
      // A robot that was started again does not know the others until it has met them.
      this.kept_all.reached = [...new Set([...this.kept_all.reached, ...named(robots.filter((one) => one.fate))])];
      const all = [...named(robots), ...this.kept_all.reached];
      if (all.every((robot) => this.kept_all.settled.includes(robot))) this.kept_all = null;
      this.keep_all();
    },
    // The robots that have not confirmed the press, and that the station does not know any more.
    missing() {
      const { settled = [], reached = [] } = this.kept_all ?? {};
      const is_missing = (robot) => !settled.includes(robot) && !this.answer.robots.some((one) => one.robot === robot);
      return reached.filter(is_missing).map((robot) => ({ robot, state: "NOT CONFIRMED: this robot has not met it again" }));
    },
    // Tells the panel with all robots how each is.
    tell_robots() {
      const { answer, kept_all } = this;
      if (!answer?.robots) return;
      const pressed_s = kept_all ? (performance.timeOrigin + this.now_ms - kept_all.pressed_ms) / 1000 : null;
      const detail = { robots: [...answer.robots, ...this.missing()], pressed_s, is_at_station: this.is_at_all && !this.is_lost, is_lost: this.is_lost };
      dispatchEvent(new CustomEvent("robbie-robots", { detail }));
    },
    beat() {
      this.now_ms = performance.now();
      if (window.socket?.connected) this.page_ms = this.now_ms;
      this.tell_age();
      this.tell_robots();
      const { socket } = this;
      const limit_ms = socket.readyState === WebSocket.CONNECTING ? CONNECT_MS : LOST_MS;
      const silent_ms = this.now_ms - Math.max(this.heard_ms, socket.opened_ms ?? 0, socket.made_ms);
      if (socket.readyState === WebSocket.CLOSED ? this.now_ms - socket.made_ms > RETRY_MS : silent_ms > limit_ms)
        this.open();
      else this.ask();
    },
    open() {
      this.shut();
      const scheme = location.protocol === "https:" ? "wss:" : "ws:";
      const socket = new WebSocket(`${scheme}//${location.host}${address()}`);
      this.socket = Object.assign(socket, { made_ms: performance.now() });
      socket.onopen = () => {
        socket.opened_ms = performance.now();
        this.ask();
      };
      socket.onmessage = (event) => this.hear(JSON.parse(event.data));
    },
    shut() {
      if (!this.socket) return;
      this.socket.onopen = this.socket.onmessage = null;
      this.socket.close();
    },
    ask() {
      if (this.socket.readyState !== WebSocket.OPEN) return;
      // Data that has not left this machine would only delay later questions.
      if (this.socket.bufferedAmount > MAX_UNSENT_BYTES) return;
      const asked_ms = performance.now();
      this.unanswered = [...this.unanswered.slice(-MAX_UNANSWERED), asked_ms];
      this.socket.send(JSON.stringify({ asked_ms, press: this.kept?.name ?? "",
        press_all: this.kept_all?.name ?? "", settled: this.kept_all?.settled ?? [] }));
    },
    // Tells the rest of the page how late it is: the time until the last answer, or since the first question without one.
    tell_age() {
      const is_open = this.socket.readyState === WebSocket.OPEN;
      const since_ms = is_open ? (this.unanswered[0] ?? this.now_ms) : this.heard_ms;
      const age_ms = Math.max(this.trip_ms, this.now_ms - since_ms);
      dispatchEvent(new CustomEvent("robbie-link", { detail: { age_ms } }));
    },
    // Says why a page that was loaded gets no connection: what the robot, or a proxy before it, answers otherwise.
    async ask_why() {
      const { status, refusal } = this.answer ? {} : await window.ask_server();
      this.refusal = refusal || (status === 204 && !this.answer ? NO_SOCKETS : "");
    },
    async leave_when_answered() {
      if (this.is_leaving) return;
      this.is_leaving = true;
      // NiceGUI answers such a request without building a page.
      const question = () => ({ headers: { "NiceGUI-Check": "try_reconnect" }, signal: AbortSignal.timeout(CONNECT_MS) });
      while (!(await fetch(location.href, question()).catch(() => null))?.ok)
        await new Promise((done) => setTimeout(done, RETRY_MS));
      this.may_leave = true;
      location.reload();
    },
    hear(answer) {
      this.now_ms = performance.now();
      this.heard_ms = Math.max(this.heard_ms, answer.asked_ms);
      this.trip_ms = this.now_ms - answer.asked_ms;
      this.unanswered = this.unanswered.filter((asked_ms) => asked_ms > answer.asked_ms);
      robot_clock.add(answer.now_s, answer.asked_ms / 1000, this.now_ms / 1000);
      this.tell_age();
      this.answer = answer;
      this.hear_all(answer);
      this.tell_robots();
      this.has_ended = answer.ends;
      if (this.kept && answer.press === this.kept.name && SETTLED.includes(answer.fate)) {
        this.kept = null;
        sessionStorage.removeItem(KEPT);
      }
    },
  },
};

// How far the robot's clock is ahead of this browser's, with its limits: the robot answered after the question was asked,
// and before the answer came (clock_offset.py does the same between robots).
const robot_clock = {
  limits: null,
  at_s: 0,
  add(robot_s, asked_s, now_s) {
    const [least, most] = [robot_s - now_s, robot_s - asked_s];
    const drift_s = MAX_DRIFT * (now_s - this.at_s);
    const [low, high] = this.limits ?? [-Infinity, Infinity];
    const narrowed = [Math.max(least, low - drift_s), Math.min(most, high + drift_s)];
    this.limits = narrowed[0] <= narrowed[1] ? narrowed : [least, most]; // otherwise a clock jumped
    this.at_s = now_s;
  },
};
const MAX_DRIFT = 1e-3;
// The age of what was measured at a time of the robot's clock, s; null if that is not known.
window.robot_age_s = (born_s) => {
  if (window.log_age_s) return window.log_age_s(born_s); // beside a log, times are the log's (page/log_clock.js)
  if (born_s == null || !robot_clock.limits) return null;
  const offset_s = (robot_clock.limits[0] + robot_clock.limits[1]) / 2;
  return Math.max(0, performance.now() / 1000 + offset_s - born_s);
};
// How much longer than the fastest message so far something took, s; sent at sent_s by the robot's clock, here at came_s.
window.robot_way_s = (sent_s, came_s) =>
  robot_clock.limits ? Math.max(0, came_s + robot_clock.limits[0] - sent_s) : null;
window.age_text = (age_s) => {
  const word = window.log_age_s ? "off" : "old"; // after a seek, a log may show what comes later
  if (age_s < 9.95) return `${age_s.toFixed(1)} s ${word}`;
  return age_s < 120 ? `${Math.round(age_s)} s ${word}` : `${Math.round(age_s / 60)} min ${word}`;
};

const BEAT_MS = 250;
const LOST_MS = 1200; // after this time without an answer, the page gives the connection up and tries another
const CONNECT_MS = 3000; // maximum time for opening a connection
const RETRY_MS = 300;
const ASK_WHY_MS = 5000;
const STALE_S = 1; // a base tells its state several times a second
const SOON_MS = 700; // a press that is settled within this is not worth a word
const MAX_UNSENT_BYTES = 1000;
const MAX_UNANSWERED = 100;
const KEPT = "robbie-emergency-stop";
const KEPT_ALL = "robbie-stop-all";
const SETTLED = ["confirmed", "withdrawn"];

const NO_SOCKETS = `The robot answers, but not on a WebSocket. A proxy must pass them on (nginx: proxy_http_version 1.1;
proxy_set_header Upgrade $http_upgrade; proxy_set_header Connection "upgrade";).`;

function address() {
  return `${window.stop_prefix}/emergency-stop`;
}

function kept_press(where) {
  return JSON.parse(sessionStorage.getItem(where) ?? "null");
}

function new_name() {
  return Array.from(crypto.getRandomValues(new Uint32Array(4)), (part) => part.toString(16)).join("-");
}
