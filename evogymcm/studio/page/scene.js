// A robot in its world, drawn as the library's pictures are, from frames that a websocket brings.
const HEAD = 12; // numbers at the head of a frame
const VOXEL = 0.1; // metres

export default {
  template: `
    <div class="studio-scene" :style="{ aspectRatio: aspect }">
      <canvas ref="canvas" role="img" :aria-label="label"></canvas>
      <slot></slot>
    </div>`,
  props: {
    source: String, // path of the websocket
    view: String, // "types" or "stiffness"
    aspect: Number,
    palette: Object,
    label: String,
  },
  mounted() {
    this.shown = 0;
    this.begun = performance.now();
    this.observer = new ResizeObserver(() => this.paint());
    this.observer.observe(this.$el);
    this.connect();
  },
  unmounted() {
    this.gone = true;
    this.observer.disconnect();
    this.socket?.close();
  },
  watch: {
    source() {
      this.socket?.close();
    },
    view() {
      this.ask();
    },
  },
  methods: {
    connect() {
      if (this.gone) return;
      const prefix = window.path_prefix || "";
      const socket = new WebSocket(`ws://${location.host}${prefix}${this.source}`);
      socket.binaryType = "arraybuffer";
      socket.onopen = () => this.ask();
      socket.onmessage = (message) => {
        if (typeof message.data === "string") {
          this.scene = JSON.parse(message.data);
          if (this.scene.empty) this.data = null;
          this.paint();
          if (this.scene.empty) this.$el.dataset.step = "";
          return;
        }
        this.data = new Float32Array(message.data);
        requestAnimationFrame(() => {
          this.paint();
          this.count();
          this.ask();
        });
      };
      socket.onclose = () => setTimeout(() => this.connect(), 500);
      this.socket = socket;
    },
    ask() {
      // The next picture, once this one is drawn: a slow browser gets fewer.
      if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(`${this.aspect} ${this.view}`);
    },
    count() {
      // What tests and the page read: env-step, score, and pictures a second.
      this.shown += 1;
      const now = performance.now();
      this.$el.dataset.step = this.data[2];
      this.$el.dataset.episode = this.data[1];
      if (now - this.begun > 1000) {
        this.$el.dataset.fps = Math.round((this.shown * 1000) / (now - this.begun));
        [this.shown, this.begun] = [0, now];
      }
    },
    paint() {
      const canvas = this.$refs.canvas;
      const [width, height] = [this.$el.clientWidth, this.$el.clientHeight];
      if (!canvas || !width) return;
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
      }
      const pen = canvas.getContext("2d");
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.fillStyle = this.palette.sky;
      pen.fillRect(0, 0, canvas.width, canvas.height);
      if (!this.scene || !this.data) return;
      const [, , , , left, bottom, right, top] = this.data;
      const scale = canvas.width / (right - left);
      this.at = (x, y) => [(x - left) * scale, (top - y) * scale];
      this.voxel = VOXEL * scale;
      this.background(pen, canvas);
      const [n, m] = this.data.subarray(10, HEAD);
      let from = HEAD;
      const take = (count) => this.data.subarray(from, (from += count));
      const [corners, colors, otherCorners, otherColors] = [take(8 * n), take(3 * n), take(8 * m), take(3 * m)];
      this.voxels(pen, otherCorners, otherColors, this.scene.objectTypes, this.scene.objectSides);
      this.voxels(pen, corners, colors, this.scene.types, this.scene.sides);
    },
    background(pen, canvas) {
      const { scene, palette } = this;
      const floor = this.at(0, 0)[1];
      if (floor < canvas.height) {
        pen.fillStyle = palette.floor;
        pen.fillRect(0, Math.max(floor, 0), canvas.width, canvas.height);
      }
      pen.strokeStyle = palette.goal;
      pen.lineWidth = 2;
      pen.setLineDash([8, 6]);
      pen.beginPath();
      if (scene.goalX !== null) {
        const x = this.at(scene.goalX, 0)[0];
        pen.moveTo(x, 0);
        pen.lineTo(x, canvas.height);
      }
      if (scene.goalY !== null) {
        const y = this.at(0, scene.goalY)[1];
        pen.moveTo(0, y);
        pen.lineTo(canvas.width, y);
      }
      pen.stroke();
      pen.setLineDash([]);
      const fill = this.view === "stiffness" ? palette.neutralFixed : palette.fixed;
      pen.fillStyle = fill;
      const edge = this.voxel;
      pen.beginPath();
      for (const [x, y] of scene.terrain) {
        const [px, py] = this.at(x, y);
        if (px < -edge || px > canvas.width || py < -edge || py > canvas.height) continue;
        pen.rect(px, py, edge + 0.5, edge + 0.5);
      }
      pen.fill();
      pen.strokeStyle = this.shade(fill, 0.8);
      pen.lineWidth = Math.max(1, edge / 30);
      pen.beginPath();
      for (const [x, y] of scene.terrain) {
        const [px, py] = this.at(x, y);
        if (px < -edge || px > canvas.width || py < -edge || py > canvas.height) continue;
        pen.rect(px, py, edge, edge);
        pen.moveTo(px, py + edge);
        pen.lineTo(px + edge, py);
      }
      pen.stroke();
      pen.strokeStyle = this.shade(fill, 0.45);
      pen.lineWidth = Math.max(2, edge / 14);
      pen.beginPath();
      for (const [x, y, toX, toY] of scene.outline) {
        pen.moveTo(...this.at(x, y));
        pen.lineTo(...this.at(toX, toY));
      }
      pen.stroke();
    },
    voxels(pen, corners, colors, types, sides) {
      const bold = Math.max(1.5, this.voxel / 16);
      for (let i = 0; i < types.length; i++) {
        const quad = [];
        for (let k = 0; k < 4; k++) quad.push(this.at(corners[8 * i + 2 * k], corners[8 * i + 2 * k + 1]));
        const color = [...colors.subarray(3 * i, 3 * i + 3)];
        const css = `rgb(${color.map(Math.round)})`;
        pen.fillStyle = css;
        pen.strokeStyle = `rgb(${color.map((part) => Math.round(part * 0.6))})`;
        pen.lineWidth = 1;
        pen.beginPath();
        quad.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
        pen.closePath();
        pen.fill();
        pen.stroke();
        if (this.view === "types" && this.voxel >= 9 && (types[i] === 3 || types[i] === 4)) this.mark(pen, quad, types[i], color);
        pen.strokeStyle = this.palette.ink;
        pen.lineWidth = bold;
        pen.lineCap = "round";
        pen.beginPath();
        for (let k = 0; k < 4; k++) {
          if (!sides[4 * i + k]) continue;
          pen.moveTo(...quad[k]);
          pen.lineTo(...quad[(k + 1) % 4]);
        }
        pen.stroke();
      }
    },
    mark(pen, quad, type, color) {
      const mean = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
      const [one, other] = type === 3 ? [mean(quad[0], quad[3]), mean(quad[1], quad[2])] : [mean(quad[0], quad[1]), mean(quad[3], quad[2])];
      const mix = (share) => [0, 1].map((axis) => one[axis] + share * (other[axis] - one[axis]));
      pen.strokeStyle = `rgb(${color.map((part) => Math.round(part * 0.45))})`;
      pen.lineWidth = Math.max(1.5, this.voxel / 12);
      pen.lineCap = "round";
      pen.beginPath();
      pen.moveTo(...mix(0.22));
      pen.lineTo(...mix(0.78));
      pen.stroke();
    },
    rgb(hex) {
      return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
    },
    shade(hex, share) {
      return `rgb(${this.rgb(hex).map((part) => Math.round(part * share))})`;
    },
  },
};
