"use strict";
// One motion in three dimensions: bodies with their poses over time, strings, a trail, a slider for the time.
const armdynScene = (place, data, { dark = () => false } = {}) => {
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const floats = (text) => new Float32Array(bytes(text));
  const time = floats(data.time);
  const [first, last] = [time[0], time[time.length - 1]];

  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(36, 1, 0.01, 100);
  camera.up.set(0, 0, 1);
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.outputEncoding = THREE.sRGBEncoding;
  const sky = new THREE.HemisphereLight(0xffffff, 0x8a94a0, 0.75);
  sky.position.set(0, 0, 1);
  const lamp = new THREE.DirectionalLight(0xffffff, 0.65);
  scene.add(sky, lamp, lamp.target);

  const meshOf = ({ vertices, faces, colour, opacity }) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(floats(vertices), 3));
    geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes(faces)), 1));
    const material = new THREE.MeshPhongMaterial({
      color: new THREE.Color(colour).convertSRGBToLinear(), side: THREE.DoubleSide, flatShading: true, shininess: 8,
      transparent: opacity < 1, opacity, depthWrite: opacity === 1,
    });
    return new THREE.Mesh(geometry, material);
  };
  const bodies = data.bodies.map(({ poses, meshes }) => {
    const group = new THREE.Group();
    group.add(...meshes.map(meshOf));
    scene.add(group);
    return { group, poses: floats(poses) };
  });
  const lineOf = (points, colour) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: new THREE.Color(colour).convertSRGBToLinear() }));
    line.frustumCulled = false;
    scene.add(line);
    return line;
  };
  const cords = data.cords.map((text) => {
    const ends = floats(text);
    return { ends, line: lineOf(ends.slice(0, 6), 0x7b8794) };
  });
  const trail = data.trail && lineOf(floats(data.trail), 0xd55e00);

  // Where to look: at all that moves, from a side that shows the motion across.
  const whole = new THREE.Box3(), moving = new THREE.Box3(), point = new THREE.Vector3();
  const turn = new THREE.Quaternion();
  const setPose = ({ group, poses }, i, j, share) => {
    if (poses.length === 7) [i, j] = [0, 0];
    const at = (k) => 7 * k;
    group.position.fromArray(poses, at(i)).lerp(point.fromArray(poses, at(j)), share);
    group.quaternion.fromArray(poses, at(i) + 3).slerp(turn.fromArray(poses, at(j) + 3), share);
  };
  for (let k = 0; k < 9; k += 1) {
    const i = Math.round((k / 8) * (time.length - 1));
    bodies.forEach((body) => {
      setPose(body, i, i, 0);
      body.group.updateMatrixWorld(true);
      const box = new THREE.Box3().setFromObject(body.group);
      whole.union(box);
      if (body.poses.length > 7) moving.union(box);
    });
  }
  const seen = (moving.isEmpty() ? whole : moving).clone();
  if (trail) seen.union(new THREE.Box3().setFromBufferAttribute(trail.geometry.attributes.position));
  const target = seen.getCenter(new THREE.Vector3());
  const radius = Math.max(0.1, 0.5 * seen.getSize(new THREE.Vector3()).length());
  const size = seen.getSize(new THREE.Vector3());
  const flat = size.y < 0.15 * Math.max(size.x, size.z);
  const view = { turn: flat ? -Math.PI / 2 : -Math.PI / 3.2, rise: flat ? 0.1 : 0.35, far: radius * 2.6 };

  const floor = new THREE.GridHelper(Math.ceil(5 * radius), 4 * Math.ceil(5 * radius), 0xffffff, 0xffffff);
  floor.rotation.x = Math.PI / 2;
  floor.position.set(target.x, target.y, Math.min(whole.min.z, seen.min.z) - (flat ? 0.05 : 0));
  floor.visible = !flat;
  scene.add(floor);

  const canvas = renderer.domElement;
  canvas.className = "stage";
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", `${data.title}: drag to turn, scroll to come nearer, shift and drag to move`);
  const bar = document.createElement("div");
  bar.className = "scrubber";
  const play = Object.assign(document.createElement("button"), { type: "button", textContent: "play" });
  const slider = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 1000, step: "any", value: 0 });
  slider.setAttribute("aria-label", "time");
  const clock = document.createElement("output");
  const rule = document.createElement("div");
  rule.className = "rule";
  const marks = (stretches) => rule.replaceChildren(slider, ...stretches.map(({ start, end, text }) => {
    const mark = Object.assign(document.createElement("i"), { title: `${text}, ${start.toFixed(2)} to ${end.toFixed(2)} s` });
    mark.style.left = `${(100 * (start - first)) / (last - first)}%`;
    mark.style.width = `${Math.max(0.6, (100 * (end - start)) / (last - first))}%`;
    return mark;
  }));
  marks(data.marks);
  bar.append(play, rule, clock);
  place.replaceChildren(canvas, bar);

  const state = { time: first, playing: false, since: 0, stopped: false };
  const draw = () => {
    const [c, s] = [Math.cos(view.rise), Math.sin(view.rise)];
    camera.position.set(c * Math.cos(view.turn), c * Math.sin(view.turn), s).multiplyScalar(view.far).add(target);
    camera.lookAt(target);
    camera.near = view.far / 100;
    camera.far = view.far * 20;
    camera.updateProjectionMatrix();
    lamp.position.copy(camera.position);
    lamp.target.position.copy(target);
    scene.background = new THREE.Color(dark() ? 0x161c23 : 0xf4f6f8);
    floor.material.color.set(dark() ? 0x3a4552 : 0xcbd2d9).convertSRGBToLinear();
    renderer.render(scene, camera);
  };
  const show = (now, { tell = true } = {}) => {
    state.time = Math.min(Math.max(now, first), last);
    let low = 0, high = time.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (time[middle] <= state.time) low = middle; else high = middle;
    }
    const share = high === low ? 0 : (state.time - time[low]) / (time[high] - time[low]);
    bodies.forEach((body) => setPose(body, low, high, share));
    cords.forEach(({ ends, line }) => {
      const { array } = line.geometry.attributes.position;
      for (let i = 0; i < 6; i += 1) array[i] = ends[6 * low + i] * (1 - share) + ends[6 * high + i] * share;
      line.geometry.attributes.position.needsUpdate = true;
    });
    trail?.geometry.setDrawRange(0, low + 1);
    slider.value = (1000 * (state.time - first)) / (last - first);
    clock.textContent = `${state.time.toFixed(2)} s`;
    draw();
    if (tell) place.dispatchEvent(new CustomEvent("armdyn-time", { detail: state.time, bubbles: true }));
  };
  const step = (stamp) => {
    if (!state.playing || state.stopped) return;
    const passed = state.since ? Math.min(0.1, (stamp - state.since) / 1000) : 0;
    state.since = stamp;
    show(state.time + passed);
    if (state.time >= last) playing(false); else requestAnimationFrame(step);
  };
  const playing = (on) => {
    state.playing = on;
    state.since = 0;
    play.textContent = on ? "pause" : "play";
    if (on && state.time >= last) state.time = first;
    if (on) requestAnimationFrame(step);
  };
  play.addEventListener("click", () => playing(!state.playing));
  slider.addEventListener("input", () => { playing(false); show(first + (slider.value / 1000) * (last - first)); });

  // Drag turns, shift or the right button moves, the wheel or two fingers come nearer.
  const fingers = new Map();
  const apart = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  const nearer = (factor) => { view.far = Math.min(Math.max(view.far * factor, 0.2 * radius), 20 * radius); draw(); };
  canvas.addEventListener("pointerdown", (e) => { fingers.set(e.pointerId, { x: e.clientX, y: e.clientY }); canvas.setPointerCapture(e.pointerId); });
  const lift = (e) => fingers.delete(e.pointerId);
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("pointermove", (e) => {
    const from = fingers.get(e.pointerId);
    if (!from) return;
    const before = fingers.size === 2 ? apart() : 0;
    const [dx, dy] = [e.clientX - from.x, e.clientY - from.y];
    fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
    if (before) { nearer(before / apart()); return; }
    if (e.shiftKey || e.buttons === 2) {
      const scale = (2 * view.far * Math.tan((camera.fov * Math.PI) / 360)) / canvas.clientHeight;
      const right = point.set(1, 0, 0).applyQuaternion(camera.quaternion).clone();
      const up = new THREE.Vector3(0, 1, 0).applyQuaternion(camera.quaternion);
      target.addScaledVector(right, -dx * scale).addScaledVector(up, dy * scale);
    } else {
      view.turn -= dx * 0.008;
      view.rise = Math.min(Math.max(view.rise + dy * 0.008, -1.5), 1.5);
    }
    draw();
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); nearer(Math.exp(0.001 * e.deltaY)); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const turns = { ArrowLeft: -0.1, ArrowRight: 0.1 }[e.key], rises = { ArrowUp: 0.1, ArrowDown: -0.1 }[e.key];
    if (turns) view.turn += turns;
    if (rises) view.rise = Math.min(Math.max(view.rise + rises, -1.5), 1.5);
    if (turns || rises) { e.preventDefault(); draw(); }
  });

  const fit = () => {
    const [width, height] = [canvas.parentElement?.clientWidth || 300, canvas.clientHeight || 300];
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    // On a narrow screen the scene is as wide as the screen.
    camera.fov = camera.aspect < 1 ? (2 * Math.atan(Math.tan(0.314) / camera.aspect) * 180) / Math.PI : 36;
    draw();
  };
  const watch = new ResizeObserver(fit);
  watch.observe(place);
  fit();
  show(first, { tell: false });
  return {
    show: (now) => { playing(false); show(now, { tell: false }); }, draw, marks, first, last,
    end: () => { state.stopped = true; watch.disconnect(); renderer.dispose(); renderer.forceContextLoss(); place.replaceChildren(); },
  };
};
