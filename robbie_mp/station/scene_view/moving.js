import { from_json, Live, MapPicture, show_age } from "robbie-live";
import { THREE } from "nicegui-scene";

const STEP_M = 0.01; // of packed points
const POINT_PIXELS = 3;
const LOOK_MS = 200;
const WALL_M = 0.5;
const DARKEST_WALL = 90; // of 255: occupied with 65 % or more
const HIGHEST_M = 2.0; // where the colours of heights end
const LOWEST_VIEW_RAD = Math.PI / 2 - 0.03; // the camera stays above the floor
const PRESETS = { behind: [-3, 0, 2.2], above: [-0.01, 0, 12] };
// From fine to coarse: computed pixels for each pixel of the screen, in each direction, and the most blocks of walls.
const QUALITIES = [[1, Infinity], [0.7, 8000], [0.5, 4000], [0.5, 2000], [0.5, 1000]];
const GIVEN_UP_MS = 3000;
const FRAMES_PER_S = 60; // most; a hidden scene only looks whether it is in sight again
const HIDDEN_FRAMES_PER_S = 4;
// The sides of a block, by corners: 0 to 3 at the floor, 4 to 7 above them. Nobody sees its bottom.
const SIDES = [[4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
// How bright each corner is. The differences show where a wall turns, and cost nothing, unlike light.
const CORNER_SHADES = [0.4, 0.5, 0.65, 0.5, 1, 1, 1, 1];
const LINES = ["view/path", "view/trail"];
const IS_SOFTWARE = draws_in_software();
const SLOW_MS = IS_SOFTWARE ? 50 : 80; // a picture that takes longer keeps the other tiles from being drawn
const SLOW_PICTURES = IS_SOFTWARE ? 2 : 8; // after more than these, the scene gets coarser
const BEGIN_MS = IS_SOFTWARE ? 1000 : 0; // the emergency stop and the other tiles come before the first picture
const RESTS = IS_SOFTWARE ? 2 : 1; // how much longer than a slow picture takes the scene rests
// The floor is brighter than the sky in both, so that what is known of the map stands out.
const PALETTES = {
  dark: {
    sky: "#1d232a", floor: "#ebebeb", walls: "#90a4ae", goal: "#66bb6a", points: "#ff5252", brightness: 0.55,
    "view/path": "#40c4ff", "view/trail": "#ff9100",
  },
  light: {
    sky: "#b8c5d0", floor: "#ffffff", walls: "#607d8b", goal: "#2e7d32", points: "#c62828", brightness: 0.4,
    "view/path": "#01579b", "view/trail": "#a34700",
  },
};

// Models and pictures in the scene are served below the path of the page.
THREE.DefaultLoadingManager.setURLModifier((url) => (url.startsWith("/") ? window.path_prefix + url : url));

// Holds a scene and draws what moves there: follows live parts, and moves the scene's nodes and camera.
export default {
  template: `<div class="scene-moving shows-age" :data-placing="placing"><slot></slot></div>`,
  props: {
    scene: Number,
    follows: Boolean,
    colours: { type: String, default: "plain" },
    walls: { type: Boolean, default: true },
    placing: { type: String, default: "" },
  },
  computed: {
    palette() {
      return PALETTES[this.$q.dark.isActive ? "dark" : "light"];
    },
  },
  watch: {
    palette() {
      this.paint();
    },
    colours() {
      for (const name of this.sets.keys()) this.colour(name);
    },
    walls() {
      this.raised.visible = this.walls;
      this.has_changed = true;
    },
  },
  beforeMount() {
    // The scene, which is mounted before this is, asks for smooth edges. In software they take half of the time of a picture.
    if (!IS_SOFTWARE) return;
    const { getContext } = HTMLCanvasElement.prototype;
    this.restore = () => (HTMLCanvasElement.prototype.getContext = getContext);
    HTMLCanvasElement.prototype.getContext = function (kind, wish) {
      return getContext.call(this, kind, { ...wish, antialias: false });
    };
  },
  mounted() {
    this.restore?.();
    this.poses = { robot: null, goal: null, nodes: {} };
    this.updates = 0;
    this.turns = true; // whether the camera turns with the robot
    this.sets = new Map();
    this.shades = new Map();
    this.map = new MapPicture();
    this.texture = new THREE.CanvasTexture(this.map.canvas);
    this.texture.magFilter = THREE.NearestFilter;
    this.texture.colorSpace = THREE.SRGBColorSpace;
    if (IS_SOFTWARE) {
      this.texture.generateMipmaps = false; // half of the time of a picture without walls
      this.texture.minFilter = THREE.LinearFilter;
    }
    const look = { transparent: true, side: THREE.DoubleSide, map: this.texture };
    this.floor = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), new THREE.MeshBasicMaterial(look));
    this.raised = new THREE.Group();
    this.raised.visible = this.walls;
    this.wall_material = new THREE.MeshBasicMaterial({ vertexColors: true });
    this.blocks = new Map(); // the walls of each tile, and the picture that they are of
    this.goal_material = new THREE.MeshBasicMaterial({ side: THREE.DoubleSide });
    this.goal = goal_arrow(this.goal_material);
    this.paint();
    this.live = new Live("view+map", this.$el, (parts) => this.take(parts));
    this.timer = setInterval(() => this.look(), LOOK_MS);
    this.ageing = setInterval(() => show_age(this.$el, this.born_s), 200);
    this.$nextTick(() => this.look());
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.$el);
    this.$el.addEventListener("click", (event) => this.place(event));
  },
  unmounted() {
    clearInterval(this.timer);
    clearInterval(this.ageing);
    this.observer.disconnect();
    this.live.close();
  },
  methods: {
    async take(parts) {
      if (parts["view/born"]) this.born_s = from_json(parts["view/born"]);
      if (parts["view/poses"]) this.poses = from_json(parts["view/poses"]);
      for (const [name, part] of Object.entries(parts))
        if (name.startsWith("view/shades/")) this.shades.set(name.replace("shades", "points"), new Uint8Array(part));
      for (const [name, part] of Object.entries(parts))
        if (name.startsWith("view/points/") || LINES.includes(name)) this.set_points(name, part);
      if (await this.map.take(parts)) {
        this.lay_floor();
        this.raise_walls();
      }
      const { scene, controls } = getElement(this.scene) ?? {};
      if (!controls) return; // there is no 3-D here
      for (const mesh of [this.floor, this.raised, this.goal, ...this.sets.values()])
        if (mesh.parent !== scene) scene.add(mesh);
      this.move_nodes();
      this.show_goal();
      this.go_along();
      this.has_changed = true;
      this.$el.dataset.updates = this.updates += 1;
    },
    // Nodes, marks and names come with the page's other messages.
    look() {
      const component = getElement(this.scene);
      const { renderer, controls } = component ?? {};
      if (!controls) return;
      if (renderer !== this.renderer) this.draw_only_changes(component);
      component.$.props.fps = this.live.in_sight ? FRAMES_PER_S : HIDDEN_FRAMES_PER_S;
      if (!this.live.in_sight) return;
      controls.maxPolarAngle = LOWEST_VIEW_RAD;
      this.move_nodes();
      const seen = fingerprint(component.scene);
      this.has_changed ||= seen !== this.seen;
      this.seen = seen;
    },
    resize() {
      getElement(this.scene)?.resize?.();
      this.has_changed = true;
    },
    // The scene is drawn again and again, in sight or not, and that is most of what a page costs.
    draw_only_changes({ renderer, text_renderer, text3d_renderer, controls }) {
      let has_drawn = false;
      for (const texts of [text_renderer, text3d_renderer]) {
        const render = texts.render;
        texts.render = (...what) => has_drawn && render.apply(texts, what);
      }
      const render = renderer.render;
      const gl = renderer.getContext();
      const rests_until_ms = performance.now() + BEGIN_MS;
      this.effort = { fence: null, begun_ms: 0, rests_until_ms, slow: 0, quality: 0 };
      if (IS_SOFTWARE) this.draw_coarser(renderer);
      renderer.render = (...what) => {
        has_drawn = false;
        if (!this.live.in_sight) {
          if (this.effort.fence) gl.deleteSync(this.effort.fence);
          this.effort.fence = null; // or the time out of sight would count as the picture's
          return;
        }
        if (!this.is_rested(gl) || !this.has_changed) return;
        this.has_changed = false;
        if (this.effort.slow > SLOW_PICTURES) this.draw_coarser(renderer);
        this.choose_walls();
        render.apply(renderer, what);
        has_drawn = true; // so that the names, which are elements of the page, are placed anew
        if (!gl.fenceSync) return;
        this.effort.begun_ms = performance.now();
        this.effort.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
        gl.flush();
      };
      controls.addEventListener("change", () => (this.has_changed = true));
      this.renderer = renderer;
      this.paint();
    },
    // Takes the colours of the page's look.
    paint() {
      this.renderer?.setClearColor(this.palette.sky);
      this.floor.material.color.set(this.palette.floor);
      this.wall_material.color.set(this.palette.walls);
      this.goal_material.color.set(this.palette.goal);
      for (const name of this.sets.keys()) this.colour(name);
      this.has_changed = true;
    },
    // Whether the last picture is complete. Where pictures take long, as without a graphics card, the scene gets coarser, and
    // rests between two pictures, so that the other tiles go on: while a picture is read back, no script of the page runs.
    is_rested(gl) {
      const { effort } = this;
      const now_ms = performance.now();
      if (effort.fence) {
        const took_ms = now_ms - effort.begun_ms;
        if (took_ms < GIVEN_UP_MS && gl.getSyncParameter(effort.fence, gl.SYNC_STATUS) !== gl.SIGNALED) return false;
        gl.deleteSync(effort.fence);
        effort.fence = null;
        if (took_ms > SLOW_MS) effort.rests_until_ms = now_ms + RESTS * Math.min(took_ms, GIVEN_UP_MS);
        effort.slow = took_ms > SLOW_MS ? effort.slow + 1 : Math.max(0, effort.slow - 1);
      }
      return now_ms >= effort.rests_until_ms;
    },
    draw_coarser(renderer) {
      const quality = Math.min(this.effort.quality + 1, QUALITIES.length - 1);
      const [ratio] = QUALITIES[quality];
      if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio); // which empties the picture
      Object.assign(this.effort, { quality, slow: 0 });
      this.$el.dataset.quality = quality;
    },
    // Raises only the walls that are nearest to what the camera looks at, if there are too many; the others lie flat.
    choose_walls() {
      const { target } = getElement(this.scene).controls;
      const { tile: size } = this.map.place ?? {};
      const centre = new THREE.Vector3(size / 2, size / 2, 0);
      const found = [...this.blocks.values()].map(({ mesh, count }) => {
        const away = this.raised.localToWorld(mesh.position.clone().add(centre)).distanceTo(target);
        return { mesh, count, away };
      });
      let left = QUALITIES[this.effort.quality][1];
      for (const { mesh, count } of found.sort((one, other) => one.away - other.away)) {
        mesh.visible = left > 0;
        left -= count;
      }
    },
    // Moves the camera as far as the robot has moved, and, behind it, turns with it.
    go_along() {
      const { camera, controls } = getElement(this.scene);
      const { robot } = this.poses;
      if (!this.follows || !robot) return (this.turned = undefined);
      const at = new THREE.Vector3(...robot.slice(0, 3));
      const yaw = yaw_of(robot.slice(3));
      const away = camera.position.clone().sub(controls.target);
      if (this.turns && this.turned !== undefined) away.applyAxisAngle(new THREE.Vector3(0, 0, 1), yaw - this.turned);
      else if (this.turns) away.applyAxisAngle(new THREE.Vector3(0, 0, 1), yaw - Math.atan2(-away.y, -away.x));
      this.turned = this.turns ? yaw : undefined;
      controls.target.copy(at);
      camera.position.copy(at).add(away);
    },
    // Puts the camera behind or above the robot, from where it follows.
    preset(name) {
      const { camera, controls } = getElement(this.scene) ?? {};
      if (!controls) return;
      this.turns = name === "behind";
      this.turned = undefined;
      camera.position.copy(controls.target).add(new THREE.Vector3(...PRESETS[name]));
      this.go_along();
      this.has_changed = true;
    },
    set_points(name, part) {
      let set = this.sets.get(name);
      if (!set) {
        set = LINES.includes(name)
          ? new THREE.Line(undefined, new THREE.LineBasicMaterial())
          : new THREE.Points(undefined, new THREE.PointsMaterial({ size: POINT_PIXELS, sizeAttenuation: false }));
        set.frustumCulled = false; // or it would be left out by where the first points were
        this.sets.set(name, set);
      }
      const metres = Float32Array.from(new Int16Array(part), (steps) => steps * STEP_M);
      set.geometry.dispose();
      set.geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(metres, 3));
      this.colour(name);
    },
    // Colours points by their height, or by how strongly they reflect; those without a measured intensity stay plain.
    colour(name) {
      const { geometry, material } = this.sets.get(name);
      this.has_changed = true;
      if (LINES.includes(name)) return material.color.set(this.palette[name]);
      const positions = geometry.getAttribute("position");
      const shades = this.shades.get(name);
      let value = null; // of point i, from 0 to 1
      if (this.colours === "height") value = (i) => positions.getZ(i) / HIGHEST_M;
      if (this.colours === "intensity" && shades?.length === positions.count) value = (i) => shades[i] / 255;
      if (value) {
        const colours = new Float32Array(3 * positions.count);
        for (let i = 0; i < positions.count; i += 1) colours.set(rainbow(value(i), this.palette.brightness), 3 * i);
        geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
      }
      material.color.set(value ? "#ffffff" : this.palette.points);
      if (material.vertexColors !== Boolean(value)) material.needsUpdate = true;
      material.vertexColors = Boolean(value);
    },
    lay_floor() {
      const { map, floor, texture } = this;
      this.floor.visible = Boolean(map.place);
      if (!map.place) return;
      const { x_m, y_m, yaw_rad, columns, rows } = map.place;
      if (this.laid !== `${columns} ${rows}`) texture.dispose(); // its size cannot be changed
      this.laid = `${columns} ${rows}`;
      texture.needsUpdate = true;
      const [w, h] = [map.width_m / 2, map.height_m / 2];
      const [cos, sin] = [Math.cos(yaw_rad), Math.sin(yaw_rad)];
      floor.scale.set(map.width_m, map.height_m, 1);
      floor.rotation.z = yaw_rad;
      floor.position.set(x_m + cos * w - sin * h, y_m + sin * w + cos * h, 0);
    },
    // Raises blocks where the map is occupied. Only tiles that have changed are raised again.
    raise_walls() {
      const { map, raised, blocks } = this;
      if (!map.place) return;
      const { x_m, y_m, yaw_rad, pixel_m, left, bottom, tile: size } = map.place;
      for (const [name, { mesh, picture }] of blocks) {
        if (map.tiles.get(name) === picture) continue;
        raised.remove(mesh);
        mesh.geometry.dispose();
        blocks.delete(name);
      }
      for (const [name, picture] of map.tiles) {
        if (blocks.has(name)) continue;
        const [across, up] = name.split("/").map(Number);
        const found = blocks_of(picture, size);
        const mesh = new THREE.Mesh(shape_of(found), this.wall_material);
        mesh.position.set(across * size, up * size, 0);
        // What is out of sight is not drawn. The radius grows with the largest scale, which is that of the heights, 1.
        mesh.geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(size / 2, size / 2, 0), size * pixel_m + WALL_M);
        raised.add(mesh);
        blocks.set(name, { mesh, picture, count: found.length });
      }
      // The blocks are in pixels of the infinite grid that the tiles lie on.
      const [cos, sin] = [Math.cos(yaw_rad), Math.sin(yaw_rad)];
      const [w, h] = [-left * pixel_m, -bottom * pixel_m];
      raised.scale.set(pixel_m, pixel_m, 1);
      raised.rotation.z = yaw_rad;
      raised.position.set(x_m + cos * w - sin * h, y_m + sin * w + cos * h, 0);
      this.$el.dataset.walls = [...blocks.values()].reduce((sum, { count }) => sum + count, 0);
    },
    show_goal() {
      const { goal } = this.poses;
      this.goal.visible = Boolean(goal);
      if (!goal) return;
      this.goal.position.set(goal[0], goal[1], 0);
      this.goal.rotation.z = goal[2];
    },
    // While a goal is to be placed, a click on the floor says where.
    place(event) {
      const { camera, renderer } = getElement(this.scene) ?? {};
      if (!this.placing || event.target !== renderer?.domElement) return;
      const box = renderer.domElement.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * 2 - 1;
      const y = 1 - ((event.clientY - box.top) / box.height) * 2;
      const ray = new THREE.Raycaster();
      camera.updateMatrixWorld(); // a camera that was moved since the last frame has half of its new pose there
      ray.setFromCamera(new THREE.Vector2(x, y), camera);
      const at = ray.ray.intersectPlane(new THREE.Plane(new THREE.Vector3(0, 0, 1), 0), new THREE.Vector3());
      if (at) this.$emit("placed", { what: this.placing, x_m: at.x, y_m: at.y, yaw_rad: null });
    },
    move_nodes() {
      const scene = getElement(this.scene)?.scene;
      for (const [name, [x, y, z, ...quaternion]] of Object.entries(this.poses.nodes)) {
        const node = scene?.getObjectByName(name);
        if (!node) continue;
        node.position.set(x, y, z);
        node.quaternion.set(...quaternion);
      }
    },
  },
};

// A number that changes when something is added, removed, moved, hidden or coloured.
function fingerprint(scene) {
  let sum = 0;
  let count = 1;
  scene.traverse(({ id, visible, position, quaternion, scale, material }) => {
    const { x, y, z, w } = quaternion;
    const parts = [id, visible ? 1 : 2, ...position, x, y, z, w, ...scale, material?.color?.getHex() ?? 0, material?.opacity ?? 0];
    for (const part of parts) sum += part * Math.sin((count += 1));
  });
  return sum;
}

function yaw_of([x, y, z, w]) {
  return Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
}

// From blue over green to red.
function rainbow(value, brightness) {
  const part = Math.max(0, Math.min(1, value));
  return new THREE.Color().setHSL(0.66 * (1 - part), 1, brightness).toArray();
}

// Blocks of occupied pixels, in pixels of the tile: where they begin and end, to the right and up. Runs of a row that lie
// exactly above those of the row before make one block with them, so that a wall is a block in whatever direction it goes.
function blocks_of(picture, size) {
  const canvas = new OffscreenCanvas(size, size);
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.drawImage(picture, 0, 0);
  const { data } = pen.getImageData(0, 0, size, size);
  const is_wall = (x, row) => data[4 * (row * size + x) + 3] > 0 && data[4 * (row * size + x)] < DARKEST_WALL;
  const blocks = [];
  let before = new Map(); // the blocks that reach the row before, by where they begin and end
  for (let row = 0; row < size; row += 1) {
    const here = new Map();
    const y = size - row; // the first row of a picture is the top
    for (let x = 0; x < size; x += 1) {
      if (!is_wall(x, row)) continue;
      const begin = x;
      while (x < size && is_wall(x, row)) x += 1;
      const key = begin * (size + 1) + x;
      const block = before.get(key) ?? { left: begin, right: x, top: y };
      if (block.top === y) blocks.push(block);
      block.bottom = y - 1;
      here.set(key, block);
    }
    before = here;
  }
  return blocks;
}

// All blocks in one shape, with as few corners as possible: where the processor computes the picture, corners are what costs.
function shape_of(blocks) {
  const corners = new Float32Array(24 * blocks.length);
  const shades = new Float32Array(24 * blocks.length);
  const triangles = new Uint32Array(30 * blocks.length);
  const shade = CORNER_SHADES.flatMap((one) => [one, one, one]);
  blocks.forEach(({ left, right, top, bottom }, at) => {
    const outline = [[left, bottom], [right, bottom], [right, top], [left, top]];
    corners.set([0, WALL_M].flatMap((z) => outline.flatMap(([x, y]) => [x, y, z])), 24 * at);
    shades.set(shade, 24 * at);
    const first = 8 * at;
    triangles.set(SIDES.flatMap(([a, b, c, d]) => [first + a, first + b, first + c, first + a, first + c, first + d]), 30 * at);
  });
  return new THREE.BufferGeometry()
    .setAttribute("position", new THREE.BufferAttribute(corners, 3))
    .setAttribute("color", new THREE.BufferAttribute(shades, 3))
    .setIndex(new THREE.BufferAttribute(triangles, 1));
}

// Whether the processor computes the pictures, because there is no graphics card.
function draws_in_software() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

function goal_arrow(material) {
  const shape = new THREE.Shape([[0.3, 0], [-0.2, 0.2], [-0.1, 0], [-0.2, -0.2]].map((xy) => new THREE.Vector2(...xy)));
  const arrow = new THREE.Mesh(new THREE.ShapeGeometry(shape), material);
  arrow.position.z = 0.05;
  const goal = new THREE.Group();
  goal.add(arrow);
  goal.visible = false;
  return goal;
}
