const CELLS = 24; // in each direction, so that the grid fills its place, whatever size that has
const GAP = 3;
const AGAIN_MS = 1000;
const across = (cells) => `calc(${cells} * var(--gs-column-width))`; // as GridStack does it
const down = (cells) => `calc(${cells} * var(--gs-cell-height))`;
const CONFIRMED_MS = 1000; // the station confirms the shape of the window within this time; otherwise it is told again

// The tiles of a layout. It emits "arranged", with x, y, width and height of each, when the visitor has
// moved some, and "turned" when the window is higher than wide or not, until the station confirms that.
export default {
  template: `<div class="tile-grid" :class="{ 'has-alone': alone, 'is-portrait-page': portrait }"><div class="grid-stack" ref="stack"><slot></slot></div></div>`,
  props: { places: Object, alone: String, fixed: Boolean, upright: { type: Boolean, default: null } },
  data() {
    return { portrait: innerHeight > innerWidth };
  },
  mounted() {
    const { style } = this.$refs.stack;
    style.setProperty("--gs-column-width", `${100 / CELLS}%`);
    style.setProperty("--gs-cell-height", `${this.cell()}px`);
    for (const side of ["top", "right", "bottom", "left"]) style.setProperty(`--gs-item-margin-${side}`, `${GAP}px`);
    this.observer = new ResizeObserver(() => {
      if (this.grid) this.grid.cellHeight(this.cell());
      else style.setProperty("--gs-cell-height", `${this.cell()}px`);
      this.turn();
    });
    this.observer.observe(this.$el);
    this.lay();
    this.$nextTick(() => this.turn());
    this.timer = setInterval(() => this.turn(), CONFIRMED_MS);
    if (!this.fixed) window.first_picture.then(() => this.let_move());
  },
  updated() {
    this.lay();
  },
  unmounted() {
    clearInterval(this.timer);
    this.observer.disconnect();
    this.grid?.destroy(false);
    this.is_gone = true;
  },
  watch: {
    places: { handler: "lay", flush: "post" },
    alone: { handler: "lay", flush: "post" },
  },
  methods: {
    // Lets visitors move tiles and change their sizes. Until then, tiles are only where they belong.
    async let_move() {
      const module = await import("robbie-gridstack").catch(() => null); // the network has lost it
      if (this.is_gone) return;
      if (!module) return setTimeout(() => this.let_move(), AGAIN_MS);
      this.grid = module.GridStack.init(
        {
          column: CELLS,
          maxRow: CELLS,
          minRow: CELLS,
          cellHeight: this.cell(),
          margin: GAP,
          float: true,
          animate: false,
          auto: false,
          handle: ".tile-head",
          draggable: { cancel: "button, input, a" },
          resizable: { handles: "e, s, se, sw, w" },
          columnOpts: { columnMax: CELLS },
        },
        this.$refs.stack,
      );
      this.grid.on("dragstop resizestop", () => this.tell());
      this.laid = "";
      this.lay();
    },
    turn() {
      this.portrait = innerHeight > innerWidth;
      if (this.upright !== this.portrait) this.$emit("turned", { portrait: this.portrait });
    },
    cell() {
      return Math.max(8, this.$el.clientHeight / CELLS);
    },
    tiles() {
      return [...this.$refs.stack.children].filter((one) => one.id?.startsWith("tile-"));
    },
    lay() {
      const { grid, places, alone } = this;
      const wanted = JSON.stringify([places, alone, this.tiles().map((one) => one.id)]);
      if (wanted === this.laid) return;
      this.laid = wanted;
      grid?.batchUpdate();
      for (const tile of [...(grid?.getGridItems() ?? [])]) grid.removeWidget(tile, false, false);
      for (const tile of this.tiles()) {
        const panel = tile.id.slice("tile-".length);
        const place = places[panel];
        tile.classList.toggle("is-away", !place);
        tile.classList.toggle("is-alone", panel === alone);
        if (!place) continue;
        const [x, y, w, h] = place;
        if (grid) grid.makeWidget(tile, { id: panel, x, y, w, h, minW: 2, minH: 2, autoPosition: false });
        else Object.assign(tile.style, { left: across(x), top: down(y), width: across(w), height: down(h) });
      }
      grid?.batchUpdate(false);
    },
    tell() {
      const places = {};
      for (const { id, x, y, w, h } of this.grid.save(false)) places[id] = [x, y, w ?? 1, h ?? 1];
      this.laid = JSON.stringify([places, this.alone, this.tiles().map((one) => one.id)]);
      this.$emit("arranged", places);
    },
  },
};
