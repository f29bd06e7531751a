// Search runs in a Worker, and browsers start none for pages that were opened from disk. There this stands in for it: the
// Worker's script runs in a hidden frame, with the same messages to and fro. (The theme's own stand-in would be fetched
// from another site.)
if (location.protocol === "file:") {
  window.Worker = class IFrameWorker extends EventTarget {
    constructor(url) {
      super();
      const frame = document.body.appendChild(document.createElement("iframe"));
      frame.hidden = true;
      const inside = frame.contentWindow;
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      const script = inside.document.createElement("script");
      this.started = new Promise((resolve) => (script.onload = () => resolve(inside)));
      script.src = url;
      inside.document.body.append(script);
    }

    async postMessage(data) {
      const inside = await this.started;
      inside.dispatchEvent(new MessageEvent("message", { data }));
    }
  };
}
