import { from_json, Live, MapPicture } from "robbie-live";
import { THREE } from "nicegui-scene";

const STEP_M = 0.01; // of packed points
const POINT_PIXELS = 3;
const LOOK_MS = 200;

// Holds a scene and draws what moves there: follows live parts, and moves the scene's nodes and camera.
export default {
  template: `<div class="scene-moving"><slot></slot></div>`,
  props: { scene: Number, follows: Boolean },
  mounted() {
    this.poses = { robot: null, nodes: {} };
    this.updates = 0;
    this.sets = new Map();
    this.map = new MapPicture();
    this.texture = new THREE.CanvasTexture(this.map.canvas);
    this.texture.magFilter = THREE.NearestFilter;
    this.texture.colorSpace = THREE.SRGBColorSpace;
    const look = { color: "#ebebeb", transparent: true, side: THREE.DoubleSide, map: this.texture };
    this.floor = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), new THREE.MeshBasicMaterial(look));
    this.live = new Live("view+map", this.$el, (parts) => this.take(parts));
    this.timer = setInterval(() => this.look(), LOOK_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    this.live.close();
  },
  methods: {
    async take(parts) {
      if (parts["view/poses"]) this.poses = from_json(parts["view/poses"]);
      for (const [name, part] of Object.entries(parts))
        if (name.startsWith("view/points/") || name === "view/path") this.set_points(name, part);
      if (await this.map.take(parts)) this.lay_floor();
      const { scene, camera, controls } = getElement(this.scene) ?? {};
      if (!controls) return; // there is no 3-D here
      for (const mesh of [this.floor, ...this.sets.values()]) if (mesh.parent !== scene) scene.add(mesh);
      this.move_nodes();
      if (this.follows && this.poses.robot) {
        const [x, y, z] = this.poses.robot;
        const way = new THREE.Vector3(x, y, z).sub(controls.target);
        camera.position.add(way);
        controls.target.add(way);
      }
      this.has_changed = true;
      this.$el.dataset.updates = this.updates += 1;
    },
    // Nodes, marks and names come with the page's other messages, so every now and then something is new.
    look() {
      const { renderer, controls } = getElement(this.scene) ?? {};
      if (!controls) return;
      if (renderer !== this.renderer) this.draw_only_changes(renderer, controls);
      this.move_nodes();
      this.has_changed = true;
    },
    // The scene is drawn again and again, in sight or not, and that is most of what a page costs.
    draw_only_changes(renderer, controls) {
      const render = renderer.render;
      renderer.render = (...what) => {
        if (!this.live.in_sight || !this.has_changed) return;
        this.has_changed = false;
        render.apply(renderer, what);
      };
      controls.addEventListener("change", () => (this.has_changed = true));
      this.renderer = renderer;
    },
    set_points(name, part) {
      let set = this.sets.get(name);
      if (!set) {
        const points = { color: "#ff5252", size: POINT_PIXELS, sizeAttenuation: false };
        set = name === "view/path"
          ? new THREE.Line(undefined, new THREE.LineBasicMaterial({ color: "#40c4ff" }))
          : new THREE.Points(undefined, new THREE.PointsMaterial(points));
        set.frustumCulled = false; // or it would be left out by where the first points were
        this.sets.set(name, set);
      }
      const metres = Float32Array.from(new Int16Array(part), (steps) => steps * STEP_M);
      set.geometry.dispose();
      set.geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(metres, 3));
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
