// "Break the sensor": one axis, 60 fixes, three filters over kalman.js. Track, scenes and sentences are the package's
// (docs/break_sensor.py). What is broken stands in the address: #sensor=gap&lost=28-35&pulled=46:2.6.
const sensor = (() => {
  // All three on positions z, from the origin at rest.
  function run(z, { dt, Q, r, p0, ahead, origin }) {
    const system = { dt, Q, r, H: ahead ? [1, dt] : [1, 0] }, x0 = [origin, 0];
    const steady = kalman.steadyState(system), own = kalman.taps(steady, kalman.order(steady.A));
    return {
      kalman: kalman.filter(z, system, x0, [p0, 0, p0]),
      constant: kalman.filter(z, system, x0, steady.P, steady.K),
      fir: kalman.fir(z, system, x0, own),
      order: own.length,
      rest: steady.K[0],
      weights: own.reduce((sum, tap) => sum + tap[0], 0),
    };
  }

  return { run };
})();

const stage = document.querySelector(".sensor");
if (stage) {
  const given = JSON.parse(stage.dataset.sensor), N = given.truth.length;
  const NAMES = { gap: "gap", outlier: "outlier", lag: "wrong H", lasting: "errors last", far: "far away" };
  const state = {}, at = { fix: 1, fact: "whole" };
  const fixes = Array.from({ length: N }, (_, i) => i + 1);
  const rms = (values) => Math.sqrt(values.reduce((sum, each) => sum + each * each, 0) / values.length);

  function take(name) {
    const scene = given.scenes[name];
    Object.assign(state, { name, ahead: scene.ahead, lasts: scene.lasts, origin: scene.origin, lost: new Set(scene.lost),
      pulled: new Map(Object.entries(scene.pulled).map(([fix, off]) => [Number(fix), off])) });
    at.fact = name;
    at.fix = scene.lost.at(-1) ?? [...state.pulled.keys()][0] ?? 1;
  }

  // Errors of the fixes in metres, lost ones too: hollow dots show where they would be.
  const errors = () => fixes.map((fix, i) => state.pulled.get(fix) ?? given.noise[i] + (state.lasts ? given.lasting[i] : 0));

  function compute() {
    const off = errors(), truth = given.truth.map((each) => each + state.origin);
    const z = fixes.map((fix, i) => state.lost.has(fix) ? null : truth[i] + off[i]);
    const seen = sensor.run(z, { ...given, ...state });
    const error = (x) => x.map(([s], i) => s - truth[i]);
    const sigma = (each) => each.P.map(([variance]) => Math.sqrt(variance));
    const out = { off, rest: seen.rest, order: seen.order, weights: seen.weights, kalman: error(seen.kalman.x), sigma: sigma(seen.kalman),
      gain: seen.kalman.K.map((each) => each?.[0] ?? null), nis: seen.kalman.nis,
      constant: error(seen.constant.x), sigmaConstant: sigma(seen.constant), fir: error(seen.fir) };
    out.counted = fixes.filter((fix) => fix > given.settled && !state.lost.has(fix)).map((fix) => fix - 1);
    return out;
  }

  // Which sentence: that of the last thing done, else of what is still broken.
  function fact() {
    const there = { gap: state.lost.size, outlier: state.pulled.size, lag: state.ahead, lasting: state.lasts, far: state.origin };
    return there[at.fact] ? at.fact : Object.keys(there).find((name) => there[name]) ?? "whole";
  }

  // The gap that is spoken of, [first, last]: the one with the fix last touched, else the last one.
  function gap() {
    const inside = state.lost.has(at.fix) ? at.fix : Math.max(...state.lost);
    let first = inside, last = inside;
    while (state.lost.has(first - 1)) first--;
    while (state.lost.has(last + 1)) last++;
    return [first, last];
  }

  const fill = (text, words) => text.replace(/{(\w+)}/g, (_, name) => words[name]);

  function said(seen) {
    const pick = (values) => seen.counted.map((i) => values[i]), size = (value, digits = 1) => Math.abs(value).toFixed(digits);
    const percent = (share) => `${(100 * share).toFixed(0)} %`;
    const words = { rest: percent(seen.rest), order: seen.order, weights: seen.weights.toFixed(4), counted: seen.counted.length };
    let name = fact();
    if (seen.counted.length) {
      const nis = pick(seen.nis).reduce((sum, each) => sum + each, 0) / seen.counted.length, [low, high] = given.band[seen.counted.length - 1];
      words.test = fill(given.sentences[low <= nis && nis <= high ? "unseen" : "seen"], { nis: nis.toFixed(1) });
      words.outside = seen.counted.filter((i) => Math.abs(seen.kalman[i]) > 2 * seen.sigma[i]).length;
      words.late = size(rms(pick(seen.kalman)));
      words.times = (rms(pick(seen.kalman)) / rms(pick(seen.sigma))).toFixed(0);
      Object.assign(words, { km: state.origin / 1000, off: size(pick(seen.fir).reduce((sum, each) => sum + each, 0) / seen.counted.length) });
    } else if (["lag", "lasting", "far"].includes(name)) name = "open";
    if (name === "gap") {
      const [first, last] = gap(), count = last - first + 1;
      if (last === N) name = "open";
      else Object.assign(words, { missing: `${count} missing fix${count > 1 ? "es" : ""}`, jump: percent(seen.gain[last]), kalman: size(seen.kalman[last]),
        constant: size(seen.constant[last]), sigma: seen.sigma[last].toFixed(2), sigma_constant: seen.sigmaConstant[last].toFixed(2) });
    }
    words.band = size(2 * seen.sigma[N - 1]);
    if (name === "outlier") {
      const fix = state.pulled.has(at.fix) ? at.fix : [...state.pulled.keys()].at(-1), nis = seen.nis[fix - 1];
      if (nis < given.usual) name = "small";
      Object.assign(words, { fix, off: size(state.pulled.get(fix)), share: percent(seen.gain[fix - 1]), nis: nis.toFixed(0), usual: given.usual.toFixed(0) });
    }
    return fill(given.sentences[name], words);
  }

  // The drawing: errors in metres, from `TOP` to `BOTTOM`, with a label at each line.
  const LEFT = 30, RIGHT = 6, TOP = 4, BOTTOM = 204, HEIGHT = 224, LETTER = 6.7; // LETTER: the width of one, on average
  let width = 374;
  const across = (fix) => LEFT + (fix - 0.5) * (width - LEFT - RIGHT) / N;
  const down = (metres) => TOP + (BOTTOM - TOP) * (given.reach - Math.max(-given.reach, Math.min(given.reach, metres))) / (2 * given.reach);
  const path = (points) => "M" + points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L");
  const line = (name, values, from = 0) => `<path class="${name}" d="${path(values.slice(from).map((each, i) => [across(i + from + 1), down(each)]))}"/>`;
  const text = (x, y, words, { name = "", anchor = "start" } = {}) => `<text class="${name}" x="${x.toFixed(1)}" y="${y.toFixed(1)}" text-anchor="${anchor}">${words}</text>`;

  // What is labelled: [filter, words, fix]. After a gap both filters at its first fix, else a line where it is furthest off.
  function labels(seen, name) {
    const metres = (values, fix) => `${Math.abs(values[fix - 1]).toFixed(1)} m`;
    const furthest = (values) => fixes.slice(given.settled, -4).reduce((a, b) => Math.abs(values[a - 1]) >= Math.abs(values[b - 1]) ? a : b);
    const last = name === "gap" ? gap()[1] : N;
    if (last < N) return [["kalman", `Kalman: ${metres(seen.kalman, last + 1)}`, last + 1], ["constant", `constant gain: ${metres(seen.constant, last + 1)}`, last + 1]];
    const both = furthest(seen.kalman), found = [["kalman", "Kalman and constant gain", both]];
    return name === "far" ? [...found, ["fir", `FIR: ${metres(seen.fir, furthest(seen.fir))}`, furthest(seen.fir)]] : found;
  }

  // What the band and the red line are: in the first corner that no label has taken.
  function note(name, lines, order, taken) {
    const long = LETTER * Math.max(...lines.map((each) => each.length)), tall = 15 * lines.length;
    const lefts = [LEFT + 5, width - RIGHT - 5 - long], tops = { top: TOP + 3, bottom: BOTTOM - 5 - tall };
    const corners = lefts.flatMap((left) => order.map((end) => [left, tops[end], left + long, tops[end] + tall]));
    const free = corners.find(([a, b, c, d]) => taken.every(([left, top, right, bottom]) => c < left || right < a || d < top || bottom < b));
    const [left, top] = free ?? corners[0];
    if (free) taken.push(free);
    return lines.map((each, i) => text(left, top + 12 + 15 * i, each, { name: `label note ${name}` })).join("");
  }

  function draw() {
    width = Math.max(280, stage.querySelector(".stage").clientWidth);
    const seen = compute(), name = fact(), column = across(2) - across(1), parts = [];
    parts.push(`<rect class="paper" x="${LEFT}" y="${TOP}" width="${width - LEFT - RIGHT}" height="${BOTTOM - TOP}"/>`);
    for (const fix of state.lost) parts.push(`<rect class="lost" x="${(across(fix) - column / 2).toFixed(1)}" y="${TOP}" width="${(column + 0.3).toFixed(1)}" height="${BOTTOM - TOP}"/>`);
    for (const metres of [-2, 0, 2]) parts.push(text(LEFT - 5, down(metres) + 4, String(metres).replace("-", "−"), { anchor: "end" }));
    const edge = (sign) => fixes.map((fix, i) => [across(fix), down(seen.kalman[i] + sign * 2 * seen.sigma[i])]);
    parts.push(`<path class="band" d="${path([...edge(1), ...edge(-1).reverse()])}Z"/>`);
    parts.push(`<path class="truth" d="M${LEFT} ${down(0)}H${width - RIGHT}"/>`);
    const outside = fixes.filter((fix, i) => Math.abs(seen.kalman[i]) > 2 * seen.sigma[i]);
    parts.push(`<path class="outside" d="${outside.map((fix) => `M${(across(fix) - column / 2).toFixed(1)} ${down(0)}h${column.toFixed(1)}`).join("")}"/>`);
    parts.push(line("constant", seen.constant), line("kalman", seen.kalman));
    if (state.origin) parts.push(line("fir", seen.fir, seen.order - 1)); // elsewhere it lies on the constant gain's
    for (const fix of fixes) {
      const kind = state.lost.has(fix) ? "missing" : state.pulled.has(fix) ? "pulled" : "fix";
      parts.push(`<circle class="${kind}" data-fix="${fix}" cx="${across(fix).toFixed(1)}" cy="${down(seen.off[fix - 1]).toFixed(1)}" r="${kind === "pulled" ? 4 : 2.3}"/>`);
    }
    for (const fix of [1, 20, 40, 60]) parts.push(text(across(fix), HEIGHT - 5, fix === 1 ? "fix 1" : fix, { anchor: fix === 1 ? "start" : fix === N ? "end" : "middle" }));

    const taken = []; // boxes of the labels, [left, top, right, bottom]
    const named = labels(seen, name), errorOf = ([kind, , fix]) => seen[kind][fix - 1];
    named.forEach((label, i) => {
      const [kind, words, fix] = label, error = errorOf(label), x = across(fix), long = LETTER * words.length;
      const above = named.length > 1 ? errorOf(named[1 - i]) <= error : error > 0;
      const y = above ? Math.min(down(error), down(0.8)) - 9 : Math.max(down(error), down(-0.8)) + 18;
      const rightwards = x + 9 + long < width - RIGHT;
      parts.push(`<circle class="mark ${kind}" cx="${x.toFixed(1)}" cy="${down(error).toFixed(1)}" r="5"/>`);
      const end = rightwards ? x + 9 + long : Math.max(x - 9, LEFT + 4 + long);
      taken.push([end - long, y - 12, end, y + 3]);
      parts.push(text(rightwards ? x + 9 : end, y, words, { name: `label ${kind}`, anchor: rightwards ? "start" : "end" }));
    });
    if (name === "gap") {
      const [first, last] = gap();
      if (across(last) > across(first) + 50) {
        const middle = (across(first) + across(last)) / 2;
        taken.push([middle - 28, BOTTOM - 18, middle + 28, BOTTOM]);
        parts.push(text(middle, BOTTOM - 6, "no fixes", { anchor: "middle" }));
      }
    }
    if (outside.length) parts.push(note("outside", given.notes.outside, ["top", "bottom"], taken));
    parts.push(note("kalman", given.notes.band, ["bottom", "top"], taken));
    parts.push(`<circle class="cursor" cx="${across(at.fix).toFixed(1)}" cy="${down(seen.off[at.fix - 1]).toFixed(1)}" r="9"/>`);
    board.innerHTML = `<svg viewBox="0 0 ${width} ${HEIGHT}" height="${HEIGHT}" aria-hidden="true">${parts.join("")}</svg>`;

    board.setAttribute("aria-valuenow", at.fix);
    board.setAttribute("aria-valuetext", `fix ${at.fix}, ${state.lost.has(at.fix) ? "lost" : `${state.pulled.has(at.fix) ? "pulled, " : ""}${seen.off[at.fix - 1].toFixed(1)} metres off`}`);
    const sentence = said(seen), box = stage.querySelector(".said");
    if (box.textContent !== sentence) box.textContent = sentence;
    for (const button of stage.querySelectorAll("[data-scene]")) button.setAttribute("aria-pressed", button.dataset.scene === state.name);
  }

  // The address: a scene, and what differs from it.
  const ranges = (set) => [...set].sort((a, b) => a - b).reduce((made, fix) => {
    if (made.at(-1)?.[1] === fix - 1) made.at(-1)[1] = fix;
    else made.push([fix, fix]);
    return made;
  }, []).map(([a, b]) => a === b ? `${a}` : `${a}-${b}`).join(".");
  const pulls = (map) => [...map].sort(([a], [b]) => a - b).map(([fix, off]) => `${fix}:${off}`).join("_");

  function address() {
    const scene = given.scenes[state.name], parts = [`sensor=${state.name}`];
    const lost = ranges(state.lost), pulled = pulls(state.pulled);
    if (lost !== ranges(new Set(scene.lost)) || pulled !== pulls(new Map(Object.entries(scene.pulled).map(([fix, off]) => [Number(fix), off])))) parts.push(`lost=${lost}`, `pulled=${pulled}`);
    return `#${parts.join("&")}`;
  }

  // After the drawing, and only when a gesture is over: some browsers allow a hundred of these in half a minute.
  function keep() {
    try {
      history.replaceState(null, "", address());
    } catch {
      // The figure works without its address.
    }
  }

  function read() {
    const chosen = new URLSearchParams(location.hash.slice(1)), name = chosen.get("sensor");
    if (!Object.hasOwn(given.scenes, name ?? "")) return false;
    take(name);
    const inside = (fix) => Number.isInteger(fix) && fix >= 1 && fix <= N;
    if (chosen.has("lost")) {
      state.lost = new Set((chosen.get("lost") || "").split(".").flatMap((each) => {
        const [a, b = a] = each.split("-").map(Number);
        return inside(a) && inside(b) ? fixes.slice(a - 1, b) : [];
      }));
    }
    if (chosen.has("pulled")) {
      const pairs = (chosen.get("pulled") || "").split("_").map((each) => each.split(":").map(Number));
      state.pulled = new Map(pairs.filter(([fix, off]) => inside(fix) && Number.isFinite(off)).map(([fix, off]) => [fix, limited(off)]));
    }
    for (const fix of state.lost) state.pulled.delete(fix);
    if (!given.scenes[name].lost.length && state.lost.size) at.fact = "gap";
    return true;
  }

  const limited = (off) => Math.round(Math.max(-2.9, Math.min(2.9, off)) * 10) / 10;
  function lose(fix) { state.lost.add(fix); state.pulled.delete(fix); at.fact = "gap"; }
  function pull(fix, off) { state.pulled.set(fix, limited(off)); state.lost.delete(fix); at.fact = "outlier"; }
  function restore(fix) { state.lost.delete(fix); state.pulled.delete(fix); }

  // Gestures: along the dots loses them, across pulls one, a tap brings one back.
  const CLOSE = 24, SLACK = 6;
  let gesture = null;
  const board = document.createElement("div");
  board.className = "board";
  const attributes = { tabindex: 0, role: "slider", "aria-label": "fixes", "aria-valuemin": 1, "aria-valuemax": N, "aria-describedby": "sensor-keys" };
  for (const [name, value] of Object.entries(attributes)) board.setAttribute(name, value);

  function place(event) {
    const box = board.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }
  function fixAt({ x }) {
    return Math.max(1, Math.min(N, Math.round((x - LEFT) / ((width - LEFT - RIGHT) / N) + 0.5)));
  }
  // The fix whose dot is near, or null: dots are 5 pixels apart, so the best of three neighbours is meant.
  function near(point) {
    const off = errors(), middle = fixAt(point);
    const distance = (fix) => Math.hypot(across(fix) - point.x, down(off[fix - 1]) - point.y);
    const [best] = [middle, middle - 1, middle + 1].filter((fix) => fix >= 1 && fix <= N).sort((a, b) => distance(a) - distance(b));
    return point.y < BOTTOM + 4 && distance(best) < CLOSE ? best : null;
  }

  board.addEventListener("touchstart", (event) => {
    if (event.touches.length === 1 && near(place(event.touches[0]))) event.preventDefault(); // or the page would scroll
  }, { passive: false });
  board.addEventListener("pointerdown", (event) => {
    const point = place(event), fix = near(point);
    if (!fix || event.button) return;
    gesture = { fix, point, kind: null, lost: new Set(state.lost), pulled: new Map(state.pulled) };
    board.setPointerCapture(event.pointerId);
  });
  board.addEventListener("pointermove", (event) => {
    const point = place(event);
    if (!gesture) {
      board.style.cursor = near(point) ? "grab" : "";
      return;
    }
    const dx = Math.abs(point.x - gesture.point.x), dy = Math.abs(point.y - gesture.point.y);
    gesture.kind ??= Math.max(dx, dy) < SLACK ? null : dx > dy ? "lose" : "pull";
    if (!gesture.kind) return;
    Object.assign(state, { lost: new Set(gesture.lost), pulled: new Map(gesture.pulled) });
    at.fix = gesture.fix;
    if (gesture.kind === "pull") pull(gesture.fix, given.reach - 2 * given.reach * (point.y - TOP) / (BOTTOM - TOP));
    else {
      const [from, to] = [gesture.fix, fixAt(point)].sort((a, b) => a - b);
      for (let fix = from; fix <= to; fix++) lose(fix);
    }
    draw();
  });
  board.addEventListener("pointerup", () => {
    if (!gesture) return;
    if (!gesture.kind) {
      at.fix = gesture.fix;
      restore(gesture.fix);
      draw();
    }
    gesture = null;
    keep();
  });
  board.addEventListener("pointercancel", () => {
    if (gesture) Object.assign(state, { lost: gesture.lost, pulled: gesture.pulled });
    gesture = null;
    draw();
  });

  const KEYS = {
    ArrowLeft: () => { at.fix = Math.max(1, at.fix - 1); },
    ArrowRight: () => { at.fix = Math.min(N, at.fix + 1); },
    Home: () => { at.fix = 1; },
    End: () => { at.fix = N; },
    ArrowUp: () => pull(at.fix, errors()[at.fix - 1] + 0.5),
    ArrowDown: () => pull(at.fix, errors()[at.fix - 1] - 0.5),
    " ": () => (state.lost.has(at.fix) || state.pulled.has(at.fix) ? restore : lose)(at.fix),
    Escape: () => { state.lost.clear(); state.pulled.clear(); },
  };
  board.addEventListener("keydown", (event) => {
    if (!Object.hasOwn(KEYS, event.key) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    KEYS[event.key]();
    draw();
  });
  board.addEventListener("keyup", (event) => { if (Object.hasOwn(KEYS, event.key)) keep(); });

  stage.querySelector(".scenes").innerHTML = Object.keys(given.scenes).map((name) => `<button type="button" data-scene="${name}">${NAMES[name]}</button>`).join("");
  for (const button of stage.querySelectorAll("[data-scene]")) {
    button.addEventListener("click", () => { take(button.dataset.scene); draw(); keep(); });
  }
  stage.querySelector(".still").replaceWith(board);
  stage.classList.add("moves");
  take("gap");
  const follow = () => {
    if (!read()) return;
    stage.querySelector("details").open = true;
    draw();
    stage.scrollIntoView({ block: "nearest" });
  };
  draw();
  follow();
  addEventListener("hashchange", follow);
  new ResizeObserver(() => { if (Math.abs(stage.querySelector(".stage").clientWidth - width) > 1) draw(); }).observe(stage);
}
