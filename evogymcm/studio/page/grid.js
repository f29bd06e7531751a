// A grid of cells on a canvas: strokes of mouse, pen and finger, and a cursor for the keyboard.
const LINE = "#dfe4ea";
const CURSOR = "#191c21";

export default {
  template: `
    <div class="studio-grid">
      <canvas ref="canvas" tabindex="0" role="application" :aria-label="label"
        @pointerdown="onDown" @pointermove="onMove" @pointerup="onUp" @pointercancel="onUp" @pointerleave="onLeave"
        @keydown="onKey" @focus="focused = true; draw()" @blur="focused = false; draw()" @contextmenu.prevent></canvas>
      <div class="studio-spoken" aria-live="polite">{{ spoken }}</div>
    </div>`,
  props: {
    rows: Number,
    cols: Number,
    codes: String, // a character a cell, row by row
    fills: Array, // colours of the cells, "" for none
    numbers: Array, // what is written on the cells, null for nothing
    faded: String, // "1" where a cell is of a loose piece
    brush: String, // the character that the brush draws, "" where it draws none
    ink: String, // the brush's colour
    tool: String, // "brush", "fill" or "gradient"
    label: String,
    names: Object, // of the characters
  },
  data() {
    return { focused: false, cursor: [0, 0], hover: null, start: null, last: null, spoken: "", wet: {} };
  },
  mounted() {
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.$el);
    this.draw();
  },
  unmounted() {
    this.observer.disconnect();
  },
  watch: {
    codes() { this.wet = {}; },
    fills() { this.wet = {}; },
  },
  updated() {
    this.draw();
  },
  methods: {
    size() {
      return this.$el.clientWidth / this.cols;
    },
    cellAt(event) {
      const box = this.$refs.canvas.getBoundingClientRect();
      const col = Math.floor(((event.clientX - box.left) / box.width) * this.cols);
      const row = Math.floor(((event.clientY - box.top) / box.height) * this.rows);
      return row >= 0 && col >= 0 && row < this.rows && col < this.cols ? [row, col] : null;
    },
    onDown(event) {
      const cell = this.cellAt(event);
      if (!cell) return;
      event.preventDefault();
      this.$refs.canvas.focus({ preventScroll: true });
      this.$refs.canvas.setPointerCapture(event.pointerId);
      this.start = this.last = this.cursor = cell;
      this.erases = event.button === 2;
      this.touch(cell);
      this.$emit("stroke", { phase: "start", cells: [cell], erase: this.erases });
    },
    onMove(event) {
      const cell = this.cellAt(event);
      const moved = String(cell) !== String(this.hover);
      this.hover = cell;
      if (this.start && cell && String(cell) !== String(this.last)) {
        const cells = this.between(this.last, cell);
        this.last = this.cursor = cell;
        cells.forEach((one) => this.touch(one));
        this.$emit("stroke", { phase: "go", cells, erase: this.erases });
      }
      if (moved) this.draw();
    },
    onUp() {
      if (!this.start) return;
      this.$emit("stroke", { phase: "end", cells: [this.start, this.last], erase: this.erases });
      this.start = null;
      this.draw();
    },
    onLeave() {
      this.hover = null;
      this.draw();
    },
    between([row, col], [toRow, toCol]) {
      const steps = Math.max(Math.abs(toRow - row), Math.abs(toCol - col));
      const cells = [];
      for (let i = 1; i <= steps; i++) {
        cells.push([Math.round(row + ((toRow - row) * i) / steps), Math.round(col + ((toCol - col) * i) / steps)]);
      }
      return cells;
    },
    touch([row, col]) {
      // Shows at once what the server will confirm.
      if (this.tool !== "brush") return;
      if (this.erases || this.brush) this.wet[row * this.cols + col] = this.erases || this.brush === "." ? "" : this.ink;
      this.draw();
    },
    onKey(event) {
      const moves = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
      const command = event.ctrlKey || event.metaKey;
      if (moves[event.key] && (event.shiftKey || event.altKey)) {
        this.$emit("command", { name: "shift", by: moves[event.key] });
      } else if (moves[event.key]) {
        const [down, right] = moves[event.key];
        this.cursor = [
          Math.min(Math.max(this.cursor[0] + down, 0), this.rows - 1),
          Math.min(Math.max(this.cursor[1] + right, 0), this.cols - 1),
        ];
        this.speak();
        this.draw();
      } else if (event.key === " " || event.key === "Enter") {
        this.$emit("stroke", { phase: "start", cells: [this.cursor], erase: false });
        this.$emit("stroke", { phase: "end", cells: [this.cursor, this.cursor], erase: false });
      } else if (event.key === "Delete" || event.key === "Backspace") {
        this.$emit("stroke", { phase: "start", cells: [this.cursor], erase: true });
        this.$emit("stroke", { phase: "end", cells: [this.cursor, this.cursor], erase: true });
      } else if (command && event.key.toLowerCase() === "z") {
        this.$emit("command", { name: event.shiftKey ? "redo" : "undo" });
      } else if (command && event.key.toLowerCase() === "y") {
        this.$emit("command", { name: "redo" });
      } else if (!command && event.key.length === 1 && this.names[event.key.toUpperCase()]) {
        this.$emit("command", { name: "brush", brush: event.key.toUpperCase() });
      } else {
        return;
      }
      event.preventDefault();
    },
    speak() {
      const [row, col] = this.cursor;
      const name = this.names[this.codes[row * this.cols + col]] || "empty";
      this.spoken = `row ${row + 1}, column ${col + 1}: ${name}`;
    },
    draw() {
      const canvas = this.$refs.canvas;
      if (!canvas || !this.$el.clientWidth) return;
      const ratio = window.devicePixelRatio || 1;
      const size = this.size();
      const [wide, high] = [Math.round(size * this.cols * ratio), Math.round(size * this.rows * ratio)];
      if (canvas.width !== wide || canvas.height !== high) {
        [canvas.width, canvas.height] = [wide, high];
        canvas.style.height = `${size * this.rows}px`;
      }
      const pen = canvas.getContext("2d");
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, size * this.cols, size * this.rows);
      const gap = size > 20 ? 1.5 : 0.5;
      for (let i = 0; i < this.rows * this.cols; i++) {
        this.drawCell(pen, i, size, gap);
      }
      if (this.tool === "gradient" && this.start && this.last) {
        this.drawArrow(pen, this.start, this.last, size);
      }
      const shown = this.hover && !this.start ? this.hover : null;
      if (shown) this.frame(pen, shown, size, this.ink || CURSOR, 2);
      if (this.focused) this.frame(pen, this.cursor, size, CURSOR, 2);
    },
    drawCell(pen, i, size, gap) {
      const [x, y] = [(i % this.cols) * size, Math.floor(i / this.cols) * size];
      const wet = this.wet[i];
      const fill = wet === undefined ? this.fills[i] : wet;
      pen.beginPath();
      pen.roundRect(x + gap / 2, y + gap / 2, size - gap, size - gap, size > 20 ? 4 : 0);
      if (!fill) {
        pen.fillStyle = "#f4f6f9";
        pen.fill();
        if (size > 20) {
          pen.strokeStyle = LINE;
          pen.lineWidth = 1;
          pen.stroke();
        }
        return;
      }
      pen.globalAlpha = this.faded[i] === "1" && wet === undefined ? 0.4 : 1;
      pen.fillStyle = fill;
      pen.fill();
      if (size > 14) {
        pen.strokeStyle = "rgba(0, 0, 0, 0.35)";
        pen.lineWidth = 1;
        pen.stroke();
      }
      const code = wet === undefined ? this.codes[i] : this.brush || this.codes[i];
      if (size > 14 && (code === "H" || code === "V") && !this.numbers[i]) {
        const [across, up] = code === "H" ? [0.28, 0] : [0, 0.28];
        pen.strokeStyle = "rgba(0, 0, 0, 0.45)";
        pen.lineWidth = Math.max(2, size / 14);
        pen.lineCap = "round";
        pen.beginPath();
        pen.moveTo(x + size * (0.5 - across), y + size * (0.5 - up));
        pen.lineTo(x + size * (0.5 + across), y + size * (0.5 + up));
        pen.stroke();
      }
      if (this.numbers[i] && wet === undefined) {
        pen.fillStyle = this.isDark(fill) ? "#fff" : "#191c21";
        pen.font = `500 ${Math.min(13, size * 0.34)}px system-ui, sans-serif`;
        pen.textAlign = "center";
        pen.textBaseline = "middle";
        pen.fillText(this.numbers[i], x + size / 2, y + size / 2 + 0.5);
      }
      pen.globalAlpha = 1;
    },
    isDark(color) {
      const [r, g, b] = [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16));
      return 0.3 * r + 0.59 * g + 0.11 * b < 140;
    },
    frame(pen, [row, col], size, color, width) {
      pen.strokeStyle = color;
      pen.lineWidth = width;
      pen.beginPath();
      pen.roundRect(col * size + 1, row * size + 1, size - 2, size - 2, size > 20 ? 4 : 0);
      pen.stroke();
    },
    drawArrow(pen, [row, col], [toRow, toCol], size) {
      const [x, y, toX, toY] = [col, row, toCol, toRow].map((place) => (place + 0.5) * size);
      pen.strokeStyle = pen.fillStyle = CURSOR;
      pen.lineWidth = 3;
      pen.lineCap = "round";
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(toX, toY);
      pen.stroke();
      pen.beginPath();
      pen.arc(toX, toY, 6, 0, 2 * Math.PI);
      pen.fill();
    },
  },
};
