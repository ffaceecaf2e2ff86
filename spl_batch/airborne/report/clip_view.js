"use strict";
(() => {
  const figure = document.getElementById("clip"), form = figure.querySelector("form");
  const canvas = figure.querySelector("canvas"), start = figure.querySelector("button.start");
  // A browser whose WebGL does not work keeps the still picture, and no button offers more.
  if (!document.createElement("canvas").getContext("webgl")) return;
  start.hidden = false;
  start.addEventListener("click", () => {
    if (!begin()) { start.disabled = true; start.textContent = "This browser cannot draw it"; return; }
    figure.classList.add("live");
    start.hidden = true;
    canvas.focus();
  });

  const begin = () => {
    const gl = canvas.getContext("webgl", {preserveDrawingBuffer: true});
    if (!gl) return false;
    const count = +canvas.dataset.count, extent = JSON.parse(canvas.dataset.extent);
    const colours = JSON.parse(canvas.dataset.colours), home = JSON.parse(canvas.dataset.camera);
    const packed = document.getElementById("clip-points").textContent.trim();
    const bytes = Uint8Array.from(atob(packed), c => c.charCodeAt(0));
    const radius = Math.hypot(...extent) / 2;

    const program = gl.createProgram();
    const compiled = (type, text) => {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    };
    compiled(gl.VERTEX_SHADER, `
      attribute vec3 place; attribute float kind;
      uniform mat3 turn; uniform vec3 extent; uniform vec2 scale, shift;
      uniform float size, byHeight, depth; uniform vec4 colours[5];
      varying vec3 colour;
      void main() {
        vec4 own = colours[int(kind + 0.5)];
        vec3 seen = turn * ((place - 0.5) * extent);
        float h = place.z;
        colour = mix(own.rgb, vec3(h, 0.85 - abs(h - 0.45), 1.0 - h), byHeight);
        gl_Position = vec4((seen.xy + shift) * scale, seen.z * depth, 1.0);
        if (own.a < 0.5) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
        gl_PointSize = size;
      }`);
    compiled(gl.FRAGMENT_SHADER, `
      precision mediump float; varying vec3 colour;
      void main() {
        vec2 off = gl_PointCoord - 0.5;
        if (dot(off, off) > 0.25) discard;
        gl_FragColor = vec4(colour, 1.0);
      }`);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return false;
    gl.useProgram(program);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);
    const attribute = (name, ...layout) => {
      const at = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, ...layout);
    };
    attribute("place", 3, gl.UNSIGNED_SHORT, true, 6, 0);
    attribute("kind", 1, gl.UNSIGNED_BYTE, false, 1, 6 * count);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 0);
    const uniform = name => gl.getUniformLocation(program, name);
    gl.uniform3fv(uniform("extent"), extent);
    gl.uniform1f(uniform("depth"), -1 / (2 * radius));

    let state = {...home}, asked = false;
    const draw = () => {
      asked = false;
      const ratio = window.devicePixelRatio || 1;
      canvas.width = canvas.clientWidth * ratio;
      canvas.height = canvas.clientHeight * ratio;
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      const [s, c] = [Math.sin(state.azimuth), Math.cos(state.azimuth)];
      const [st, ct] = [Math.sin(state.tilt), Math.cos(state.tilt)];
      gl.uniformMatrix3fv(uniform("turn"), false, [c, s * ct, -s * st, -s, c * ct, -c * st, 0, st, ct]);
      const aspect = canvas.width / Math.max(canvas.height, 1), scale = state.near / radius;
      gl.uniform2f(uniform("scale"), aspect > 1 ? scale / aspect : scale, aspect > 1 ? scale : scale * aspect);
      gl.uniform2f(uniform("shift"), state.east, state.up);
      gl.uniform1f(uniform("size"), form.elements.size.value * ratio);
      gl.uniform1f(uniform("byHeight"), form.elements.heights.checked ? 1 : 0);
      const shown = new Set([...form.querySelectorAll("[name=kind]:checked")].map(box => +box.value));
      gl.uniform4fv(uniform("colours"), colours.flatMap((hex, k) =>
        [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255).concat(shown.has(k) ? 1 : 0)));
      gl.drawArrays(gl.POINTS, 0, count);
      canvas.dataset.error = gl.getError();
    };
    const change = (by = {}) => {
      state = {...state, ...by};
      state.tilt = Math.min(Math.max(state.tilt, 0), Math.PI);
      state.near = Math.min(Math.max(state.near, 0.5), 60);
      if (!asked) { asked = true; requestAnimationFrame(draw); }
    };
    const metre = () => 2 * radius / state.near / Math.max(Math.min(canvas.clientWidth, canvas.clientHeight), 1);
    canvas.addEventListener("pointermove", event => {
      if (!event.buttons) return;
      const {movementX: x, movementY: y} = event;
      if (event.shiftKey || event.buttons > 1) change({east: state.east + x * metre(), up: state.up - y * metre()});
      else change({azimuth: state.azimuth + x / 200, tilt: state.tilt - y / 200});
    });
    canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("contextmenu", event => event.preventDefault());
    // The wheel moves the page until somebody works with the points.
    canvas.addEventListener("wheel", event => {
      if (document.activeElement !== canvas) return;
      event.preventDefault();
      change({near: state.near * Math.exp(-event.deltaY / 600)});
    }, {passive: false});
    const keys = {
      ArrowLeft: () => ({azimuth: state.azimuth - 0.1}), ArrowRight: () => ({azimuth: state.azimuth + 0.1}),
      ArrowUp: () => ({tilt: state.tilt - 0.1}), ArrowDown: () => ({tilt: state.tilt + 0.1}),
      "+": () => ({near: state.near * 1.2}), "-": () => ({near: state.near / 1.2}), "0": () => home,
    };
    const step = () => 40 * metre();
    const moves = {
      ArrowLeft: () => ({east: state.east - step()}), ArrowRight: () => ({east: state.east + step()}),
      ArrowUp: () => ({up: state.up + step()}), ArrowDown: () => ({up: state.up - step()}),
    };
    canvas.addEventListener("keydown", event => {
      // With another modifier a key is the browser's: it zooms the page or goes back.
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const move = (event.shiftKey && moves[event.key]) || keys[event.key];
      if (move) { event.preventDefault(); change(move()); }
    });
    form.addEventListener("input", () => change());
    form.addEventListener("reset", () => setTimeout(() => change(home)));
    new ResizeObserver(() => change()).observe(canvas);
    return true;
  };
})();
