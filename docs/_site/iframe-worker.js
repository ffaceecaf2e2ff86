// Searching without a server. The site searches in a worker, and browsers start none for a page that
// is opened as a file. There this class takes the worker's place: it runs the same script in a hidden
// frame. The theme asks whether `IFrameWorker` is known, and then loads its parts from the frame.
if (location.protocol === "file:") {
  window.IFrameWorker = window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      document.body.append(this.frame)
      const inside = this.frame.contentWindow
      const says = data => new MessageEvent("message", { data: structuredClone(data) })
      inside.document.open()
      inside.postMessage = data => this.dispatchEvent(says(data))
      inside.importScripts = (...urls) => urls.reduce(
        (before, each) => before.then(() => this.load(each)), Promise.resolve())
      inside.document.write("<!doctype html><title>Search</title><body>")
      inside.document.close()
      this.ready = this.load(url)
      this.tell = data => inside.dispatchEvent(says(data))
    }

    load(url) {
      const inner = this.frame.contentDocument
      return new Promise((loaded, failed) => {
        const script = inner.createElement("script")
        script.src = url
        script.onload = loaded
        script.onerror = () => failed(new Error(`${url} cannot be loaded`))
        inner.body.append(script)
      })
    }

    postMessage(data) {
      this.ready.then(() => this.tell(data))
    }

    terminate() {
      this.frame.remove()
    }
  }
}
