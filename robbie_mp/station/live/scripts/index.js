// Parts that the page draws many times a second; the other end is live/parts.py.

const RETRY_MS = 1000;
const WAIT_MS = 100;
let was_connected = false;

// Follows groups of live parts while an element is visible: draws each packet, then reports that.
export class Live {
  // draw(parts, came_s): draws the changed parts, as { name: ArrayBuffer }, that arrived at came_s by this browser's clock;
  // returns what to report, or nothing; may return a promise. opened(): called for each new connection.
  constructor(groups, element, draw, opened = () => {}) {
    Object.assign(this, { groups, element, draw, opened, socket: null, in_sight: false });
    this.look = this.look.bind(this);
    this.observer = new IntersectionObserver((entries) => {
      this.in_sight = entries.at(-1).isIntersecting;
      this.look();
    });
    this.observer.observe(element);
    document.addEventListener("visibilitychange", this.look);
  }

  look() {
    const wanted = this.in_sight && document.visibilityState === "visible";
    // A socket that is still opening is closed then: otherwise the browser reports an error.
    if (!wanted && this.socket?.readyState === WebSocket.CONNECTING) this.socket.onopen = () => this.look();
    else if (!wanted) this.socket?.close();
    else if (!this.socket && !this.timer) this.open();
  }

  open() {
    // While the page itself has lost its connection, there is no server to connect to. The page has just come from one.
    was_connected ||= Boolean(window.socket?.connected);
    if (was_connected && !window.socket?.connected) return this.try_again(WAIT_MS);
    const socket = (this.socket = opened_early(this.groups) ?? window.open_live(this.groups));
    socket.binaryType = "arraybuffer";
    let drawn = Promise.resolve();
    if (socket.readyState === WebSocket.OPEN) this.opened();
    else socket.onopen = () => this.opened();
    socket.onmessage = (event) => {
      const came_s = performance.now() / 1000;
      const parts = unpacked(event.data);
      const way_s = parts.sent_s && window.robot_way_s?.(from_json(parts.sent_s), came_s);
      drawn = drawn
        .then(() => this.draw(parts, came_s))
        .then((said) => new Promise(requestAnimationFrame).then(() => this.say(said ?? JSON.stringify({ way_s }), socket)));
    };
    socket.onclose = () => {
      this.socket = null;
      this.try_again();
    };
  }

  say(text, socket = this.socket) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(text);
  }

  try_again(after_ms = RETRY_MS) {
    this.timer = setTimeout(() => {
      this.timer = null;
      this.look();
    }, after_ms);
  }

  close() {
    this.observer.disconnect();
    document.removeEventListener("visibilitychange", this.look);
    this.look = () => {};
    this.socket?.close();
  }
}

// Returns the connection that the page has opened before its scripts were there (panels/camera.py), if it is still good.
function opened_early(groups) {
  const { early } = window;
  if (early?.groups !== groups) return null;
  window.early = null;
  return early.socket.readyState <= WebSocket.OPEN ? early.socket : null;
}

function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const parts = {};
  let at = 4 + length;
  for (const [name, size] of from_json(buffer.slice(4, at))) {
    parts[name] = buffer.slice(at, at + size);
    at += size;
  }
  return parts;
}

export function from_json(part) {
  return JSON.parse(new TextDecoder().decode(part));
}

// The pictures of the cameras that are in sight, on one connection for all of them; the other end is live/video.py.
class Video {
  constructor() {
    this.views = new Map();
    this.observer = new IntersectionObserver((entries) => {
      for (const one of entries) if (this.views.has(one.target)) this.views.get(one.target).in_sight = one.isIntersecting;
      this.tell();
    });
    this.resized = new ResizeObserver(() => this.tell());
  }

  // show(picture, about): shows a picture of the camera, a Blob or a VideoFrame, in the element; may return a promise.
  // drives: whether an operator drives by it, so that it comes as a stream to browsers that can decode one.
  add(element, camera, show, drives = false) {
    this.views.set(element, { camera, show, drives, in_sight: false });
    this.observer.observe(element);
    this.resized.observe(element);
    this.live ??= new Live("video", document.documentElement, this.draw.bind(this), () => this.tell(true));
    if (drives) this.load_decoder();
  }

  // Browsers have a decoder over https and on the robot's machine.
  async load_decoder() {
    await window.first_picture;
    if (!window.VideoDecoder || this.decoder) return;
    // A server that is gone will load the page again.
    const script = await import("robbie-live/picture_decoder.js").catch(() => null);
    this.decoder ??= await script?.PictureDecoder.make(() => this.tell());
    this.tell();
  }

  remove(element) {
    this.views.delete(element);
    this.observer.unobserve(element);
    this.resized.unobserve(element);
    this.tell();
    if (this.views.size) return;
    this.live?.close();
    this.live = null;
  }

  // Tells which cameras are in sight, and at which width.
  tell(is_new = false) {
    const want = {};
    for (const [element, { camera, in_sight }] of this.views)
      if (in_sight) want[camera] = Math.max(want[camera] ?? 1, Math.round(element.clientWidth * devicePixelRatio));
    const driven = [...this.views.values()].find(({ drives, in_sight }) => drives && in_sight)?.camera;
    const text = JSON.stringify({ want, ...this.decoder?.wants(driven, is_new) });
    if (text !== this.told || is_new) this.live?.say(text);
    this.told = text;
  }

  async draw(parts, came_s) {
    const about = from_json(parts.about);
    const way_s = window.robot_way_s?.(about.sent_s, came_s);
    const shown = [...this.views.values()].filter(({ camera, in_sight }) => in_sight && camera === about.camera);
    const picture = about.video
      ? await this.decoder?.decode(about.video, parts.picture)
      : about.reason ? null : new Blob([parts.picture], { type: about.type });
    if (!about.video) about.note ||= this.decoder?.note(about.camera);
    if (picture || about.reason) await Promise.all(shown.map(({ show }) => show(picture, about)));
    picture?.close?.();
    return JSON.stringify({ way_s });
  }
}

export const video = new Video();

// The map as one picture with the largest y at the top, composed of its tiles (live/map.py).
export class MapPicture {
  constructor() {
    Object.assign(this, { canvas: document.createElement("canvas"), place: null, tiles: new Map() });
  }

  get width_m() {
    return this.place.columns * this.place.pixel_m;
  }

  get height_m() {
    return this.place.rows * this.place.pixel_m;
  }

  // Whether the map is complete.
  get is_whole() {
    return this.place !== null && this.place.tiles.every((tile) => this.tiles.has(tile.join("/")));
  }

  // Returns whether anything has changed.
  async take(parts) {
    const changed = await Promise.all(
      Object.entries(parts)
        .filter(([name]) => name.startsWith("map/tile/"))
        .map(async ([name, part]) => [name.slice("map/tile/".length), await createImageBitmap(new Blob([part]))]),
    );
    for (const [name, tile] of changed) {
      this.tiles.get(name)?.close();
      this.tiles.set(name, tile);
    }
    if (parts["map/place"]) this.move_to(from_json(parts["map/place"]));
    else if (this.place) for (const [name, tile] of changed) this.draw(name, tile);
    return changed.length > 0 || Boolean(parts["map/place"]);
  }

  move_to(place) {
    this.place = place;
    const known = new Set(place.tiles.map((tile) => tile.join("/")));
    for (const name of this.tiles.keys()) if (!known.has(name)) this.tiles.delete(name);
    [this.canvas.width, this.canvas.height] = [place.columns, place.rows]; // and it is empty again
    for (const [name, tile] of this.tiles) this.draw(name, tile);
  }

  draw(name, tile) {
    const { left, bottom, rows, tile: size } = this.place;
    const [across, up] = name.split("/").map(Number);
    const [x, y] = [across * size - left, rows - ((up + 1) * size - bottom)];
    const pen = this.canvas.getContext("2d");
    pen.clearRect(x, y, size, size);
    pen.drawImage(tile, x, y);
  }
}

const OLD_POSE_S = 1; // mapping tells the pose several times a second

// Greys what an element draws, and says its age, when the robot's pose in it is old. The robot may have moved since.
export function show_age(element, born_s) {
  const age_s = window.robot_age_s?.(born_s);
  if (!element) return;
  if (age_s != null && age_s > OLD_POSE_S) element.dataset.age = `Position ${window.age_text(age_s)}`;
  else delete element.dataset.age;
}
