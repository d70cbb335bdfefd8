// "Does the time step change the filter?": a figure with sliders, over kalman.js. The state stands in the address:
// #model=cv&dt=1&...
const live = (() => {
  // Models of one axis with the state [s v] and F = [1 dt; 0 1], as mpt.gsm_axis and mpt.constant_velocity.
  const MODELS = {
    gsm: { H: (dt) => [1, dt], Q: (dt, q) => [q * dt * dt / 4, q * dt / 2, q] },
    cv: { H: () => [1, 0], Q: (dt, q) => [q * dt ** 3 / 3, q * dt * dt / 2, q * dt] },
  };

  const system = ({ model, dt, q, r }) => ({ dt, r, H: MODELS[model].H(dt), Q: MODELS[model].Q(dt, q) });
  const steadyState = (chosen) => kalman.steadyState(system(chosen));

  // Normal random numbers, the same in every browser.
  function normals(seed, count) {
    const uniform = () => {
      seed = (seed + 0x6d2b79f5) | 0;
      let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
      t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
      return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
    };
    return Array.from({ length: count }, () => Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform()));
  }

  const STEPS = 100, NOISE = normals(5, 3 * STEPS);

  // A track from s = 0 with velocity v, its measurements, and two estimates: the Kalman filter knows the start; the FIR
  // filter sums its last M measurements.
  function track({ v, M, ...chosen }) {
    const own = system(chosen), { dt, H, Q, r } = own;
    const root = Math.sqrt(Q[0]), cross = root ? Q[1] / root : 0, rest = Math.sqrt(Math.max(Q[2] - cross * cross, 0));
    const truth = [], z = [];
    let s = 0, speed = v;
    for (let k = 0; k < STEPS; k++) {
      const [w1, w2, w3] = NOISE.slice(3 * k, 3 * k + 3);
      s += dt * speed + root * w1;
      speed += cross * w1 + rest * w2;
      truth.push(s);
      z.push(H[0] * s + H[1] * speed + Math.sqrt(r) * w3);
    }
    const { x, P } = kalman.filter(z, own, [0, v], [0, 0, 0]);
    const fir = kalman.fir(z, own, [0, v], kalman.taps(kalman.steadyState(own), M));
    return { s: truth, z, kalman: x.map(([each]) => each), sigma: P.map(([each]) => Math.sqrt(each)), fir: fir.map(([each]) => each) };
  }

  return { steadyState, track, STEPS };
})();

// The drawing: a small SVG for each panel, in the colours of the page.
for (const figure of typeof document === "undefined" ? [] : document.querySelectorAll(".live")) {
  const presets = JSON.parse(figure.dataset.presets);
  const SLIDERS = {
    dt: { label: "time step Δt", unit: "s", from: -2, to: 2, log: true },
    q: { label: "process noise q", unit: "", from: -4, to: 1, log: true },
    r: { label: "measurement variance r", unit: "m²", from: -3, to: 2, log: true },
    v: { label: "velocity", unit: "m/s", from: 0, to: 30, step: 0.1 },
    M: { label: "FIR length M", unit: "measurements", from: 1, to: live.STEPS, step: 1 },
  };
  const ROWS = 41, number = (value, digits = 3) => String(Number(value.toPrecision(digits)));
  const state = {}, controls = {};
  let panels = 0;
  const ruled = (chosen) => Math.min(kalman.order(live.steadyState(chosen).A), SLIDERS.M.to);
  const take = ({ name, ...preset }) => Object.assign(state, preset, { M: ruled(preset) });

  // A panel: axes, curves of [x, y], each with its label at its end, and a mark at the chosen time step.
  function panel(title, xlabel, { curves, band, x, y, logs, mark, width = 360 }) {
    const height = 230, left = 46, right = width - 74, top = 30, bottom = height - 40, clip = `panel-${++panels}`;
    const scale = ([low, high], log) => (value) => log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    const across = (value) => left + (right - left) * scale(x, logs.includes("x"))(value);
    const up = (value) => bottom - (bottom - top) * scale(y, logs.includes("y"))(value);
    const ticks = ([low, high], log) => {
      if (log) return Array.from({ length: 25 }, (_, i) => 10 ** (i - 12)).filter((t) => t >= low * 0.99 && t <= high * 1.01);
      const rough = (high - low) / 4, unit = 10 ** Math.floor(Math.log10(rough));
      const gap = [1, 2, 5, 10].map((n) => n * unit).find((n) => n >= rough);
      return Array.from({ length: 9 }, (_, i) => (Math.ceil(low / gap) + i) * gap).filter((t) => t <= high * 1.0001);
    };
    const path = (points) => "M" + points.map(([a, b]) => `${across(a).toFixed(1)} ${up(b).toFixed(1)}`).join("L");
    const grid = ticks(x, logs.includes("x")).map((t) => `<path class="grid" d="M${across(t)} ${top}V${bottom}"/>`
      + `<text x="${across(t)}" y="${bottom + 16}" text-anchor="middle">${number(t)}</text>`);
    grid.push(...ticks(y, logs.includes("y")).map((t) => `<path class="grid" d="M${left} ${up(t)}H${right}"/>`
      + `<text x="${left - 5}" y="${up(t) + 4}" text-anchor="end">${number(t)}</text>`));
    const ends = curves.map(({ points }) => Math.min(Math.max(up(points.at(-1)[1]), top), bottom));
    const close = ends.length === 2 && Math.abs(ends[0] - ends[1]) < 14;
    const drawn = curves.map(({ name, points }, i) => {
      const at = close ? (ends[0] + ends[1]) / 2 + (ends[i] < ends[1 - i] || (ends[0] === ends[1] && !i) ? -7 : 7) : ends[i];
      return `<path class="curve c${i}" clip-path="url(#${clip})" d="${path(points)}"/><text class="c${i}" x="${right + 5}" y="${at + 4}">${name}</text>`;
    });
    const shaded = band ? `<path class="band" clip-path="url(#${clip})" d="${path([...band.map(([a, b]) => [a, b]), ...band.map(([a, b]) => [a, -b]).reverse()])}Z"/>` : "";
    const here = mark ? mark.map(([a, b]) => `<circle cx="${across(a)}" cy="${up(b)}" r="4.5"/>`).join("") : "";
    return `<svg viewBox="0 0 ${width} ${height}" aria-hidden="true"><clipPath id="${clip}"><rect x="${left}" y="${top - 2}" width="${right - left}" height="${bottom - top + 4}"/></clipPath>`
      + `<text class="title" x="2" y="15">${title}</text>${grid.join("")}`
      + `${shaded}${drawn.join("")}${here}<text x="${(left + right) / 2}" y="${height - 6}" text-anchor="middle">${xlabel}</text></svg>`;
  }

  function draw() {
    const { model, dt, M } = state, { K, A, P } = live.steadyState(state);
    const steps = Array.from({ length: ROWS }, (_, i) => 10 ** (-2 + i / 10));
    const over = steps.map((each) => [each, live.steadyState({ ...state, dt: each })]);
    const spread = (values) => [10 ** Math.floor(Math.log10(Math.min(...values)) + 0.001), 10 ** Math.ceil(Math.log10(Math.max(...values)) - 0.001)];
    const sigma = over.map(([each, { P }]) => [each, Math.sqrt(P[0])]);
    const gain = [0, 1].map((i) => over.map(([each, { K }]) => [each, K[i]]));
    const t = live.track(state), k = t.s.map((_, i) => i + 1);
    const errors = [t.kalman, t.fir].map((estimate) => estimate.map((each, i) => [k[i], each - t.s[i]]));
    const late = errors.flat().filter(([at]) => at > live.STEPS / 3).map(([, error]) => Math.abs(error));
    const worst = Math.max(...errors[1].map(([, error]) => Math.abs(error)));
    const reach = 1.1 * Math.max(4 * Math.sqrt(P[0]), ...late);
    // The lower panels stand side by side where there is room; each is drawn at its own width, so that letters have one size.
    const room = figure.querySelector(".panels").clientWidth, columns = room >= 560 ? 2 : 1;
    const wide = { x: [0.01, 100], logs: "xy", width: Math.max(Math.floor((room - 7 * (columns - 1)) / columns), 270) };
    figure.querySelector(".panels").innerHTML = [
      panel("error of one track (m)", "step k", { x: [1, live.STEPS], y: [-reach, reach], logs: "", width: Math.max(room, 270),
        band: k.map((each, i) => [each, 2 * t.sigma[i]]), curves: [{ name: "Kalman", points: errors[0] }, { name: "FIR", points: errors[1] }] }),
      panel("σ of the position (m)", "time step Δt (s)", { ...wide, y: spread(sigma.map(([, s]) => s)), mark: [[dt, Math.sqrt(P[0])]],
        curves: [{ name: "σ", points: sigma }] }),
      panel("the constant gain", "time step Δt (s)", { ...wide, y: spread(gain.flat().map(([, g]) => g)), mark: [[dt, K[0]], [dt, K[1]]],
        curves: [{ name: "position", points: gain[0] }, { name: "velocity", points: gain[1] }] }),
    ].join("");
    const rule = kalman.order(A), last = errors.map((each) => number(Math.abs(each.at(-1)[1]), 2));
    figure.querySelector(".said").textContent = `With Δt = ${number(dt)} s the constant gain is ${number(K[0])} for the position and `
      + `${number(K[1])} 1/s for the velocity; σ of the position is ${number(Math.sqrt(P[0]))} m. The rule ‖Aᴹ‖ < 0.001 takes M = ${rule}${rule > live.STEPS ? ", more than this track has" : ""}; `
      + `at step ${live.STEPS} the Kalman filter is off by ${last[0]} m, the FIR filter with M = ${M} by ${last[1]} m`
      + `${worst > reach ? `; its largest error, ${number(worst, 2)} m, lies outside the panel` : ""}.`;
    for (const [name, { unit, log }] of Object.entries(SLIDERS)) {
      const { input, value } = controls[name];
      input.value = log ? Math.log10(state[name]) : state[name];
      value.textContent = `${number(state[name])} ${name === "q" ? (model === "cv" ? "m²/s³" : "m²/s²") : unit}`;
      if (name === "M" && rule > M && M === live.STEPS) value.textContent = `all ${M} (rule: ${rule})`;
      input.setAttribute("aria-valuetext", value.textContent);
    }
    for (const button of figure.querySelectorAll("[data-preset]")) {
      const preset = presets[button.dataset.preset];
      button.setAttribute("aria-pressed", ["model", "dt", "q", "r", "v"].every((name) => state[name] === preset[name]));
    }
  }

  function read() {
    const chosen = new URLSearchParams(location.hash.slice(1));
    if (!chosen.has("dt")) return;
    if (chosen.get("model") in { gsm: 0, cv: 0 }) state.model = chosen.get("model");
    for (const [name, { from, to, log }] of Object.entries(SLIDERS)) {
      const value = Number(chosen.get(name)), [low, high] = log ? [10 ** from, 10 ** to] : [from, to];
      if (chosen.has(name) && Number.isFinite(value)) state[name] = Math.min(Math.max(value, low), high);
    }
    state.M = Math.round(state.M);
  }

  // After the drawing, and only when a slider is let go: some browsers allow a hundred of these in half a minute.
  function keep() {
    try {
      history.replaceState(null, "", "#" + new URLSearchParams(state));
    } catch {
      // The figure works without its address.
    }
  }

  const rows = Object.entries(SLIDERS).map(([name, { label, from, to, log, step }]) => `<div class="slider"><label for="live-${name}">${label}</label>`
    + `<input id="live-${name}" name="${name}" type="range" min="${from}" max="${to}" step="${log ? 0.02 : step}"><span class="value"></span></div>`);
  const buttons = Object.entries(presets).map(([key, { name }]) => `<button type="button" data-preset="${key}">${name}</button>`);
  figure.querySelector(".still").remove();
  figure.querySelector(".controls").innerHTML = `<p class="presets">As in the paper of ${buttons.join(" ")}</p>${rows.join("")}`;
  for (const [name, { log }] of Object.entries(SLIDERS)) {
    const input = figure.querySelector(`#live-${name}`);
    controls[name] = { input, value: input.nextElementSibling };
    input.addEventListener("input", () => {
      state[name] = log ? Number((10 ** Number(input.value)).toPrecision(3)) : Number(input.value);
      if (["dt", "q", "r"].includes(name)) state.M = ruled(state);
      draw();
    });
    input.addEventListener("change", keep);
  }
  for (const button of figure.querySelectorAll("[data-preset]")) {
    button.addEventListener("click", () => {
      take(presets[button.dataset.preset]);
      draw();
      keep();
    });
  }
  take(presets[figure.dataset.preset]);
  read();
  addEventListener("hashchange", () => { read(); draw(); });
  addEventListener("resize", draw);
  draw();
}
