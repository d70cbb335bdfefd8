// The filters of both figures that can be touched, for one axis: states are [s, v], symmetric matrices [P_ss, P_sv, P_vv],
// F = [1 dt; 0 1], H = [h, g]. A system is { dt, Q, r, H }. A test in the browser holds all of it to the package.
const kalman = (() => {
  const predicted = ([a, b, d], { dt, Q }) => [a + 2 * dt * b + dt * dt * d + Q[0], b + dt * d + Q[1], d + Q[2]];
  const variance = ([a, b, d], { H: [h, g], r }) => h * h * a + 2 * h * g * b + g * g * d + r;
  const gain = (P, system) => {
    const S = variance(P, system), [h, g] = system.H;
    return [(h * P[0] + g * P[1]) / S, (h * P[1] + g * P[2]) / S];
  };
  const times = ([a, b, c, d], [e, f, g, h]) => [a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h];

  // I - K H, and Joseph's form (I - K H) P (I - K H)' + K r K', which holds for any gain.
  const left = (K, [h, g]) => [1 - K[0] * h, -K[0] * g, -K[1] * h, 1 - K[1] * g];
  function corrected([a, b, d], K, { H, r }) {
    const [m, n, o, p] = left(K, H);
    const [ma, mb, oa, ob] = times([m, n, o, p], [a, b, b, d]);
    return [ma * m + mb * n + r * K[0] * K[0], ma * o + mb * p + r * K[0] * K[1], oa * o + ob * p + r * K[1] * K[1]];
  }

  // The Riccati recursion until it rests: the constant gain K, its covariance P, and A = (I - K H) F.
  function steadyState(system) {
    let P = [0, 0, 0], K = [0, 0];
    for (let k = 0, moved = Infinity; k < 3e5 && moved > 2e-15; k++) {
      const before = predicted(P, system);
      K = gain(before, system);
      const after = corrected(before, K, system), size = [after[0], Math.sqrt(after[0] * after[2]), after[2]];
      moved = Math.max(...after.map((each, i) => Math.abs(each - P[i]) / size[i]));
      P = after;
    }
    return { K, P, A: times(left(K, system.H), [1, system.dt, 0, 1]) };
  }

  // How many measurements the FIR filter takes: the first M at which the largest singular value of A^M is below tol.
  function order(A, tol = 1e-3) {
    const norm = ([a, b, c, d]) => {
      const sum = a * a + b * b + c * c + d * d, det = a * d - b * c;
      return Math.sqrt((sum + Math.sqrt(Math.max(sum * sum - 4 * det * det, 0))) / 2);
    };
    let M = 1;
    for (let power = A; norm(power) >= tol && M < 1e5; M++) power = times(power, A);
    return M;
  }
  // Its taps A^j K.
  function taps({ A, K }, M) {
    const made = [K];
    while (made.length < M) {
      const [x, y] = made.at(-1);
      made.push([A[0] * x + A[1] * y, A[2] * x + A[3] * y]);
    }
    return made;
  }

  // A filter over positions z, null where a fix is lost; without a constant gain it computes its own.
  function filter(z, system, x0, P0, constant = null) {
    const out = { x: [], P: [], K: [], nis: [] }, [h, g] = system.H;
    let x = x0, P = P0;
    for (const each of z) {
      x = [x[0] + system.dt * x[1], x[1]];
      P = predicted(P, system);
      if (each === null) {
        out.K.push(null);
        out.nis.push(null);
      } else {
        const K = constant ?? gain(P, system), innovation = each - h * x[0] - g * x[1];
        out.K.push(K);
        out.nis.push(innovation * innovation / variance(P, system));
        x = [x[0] + K[0] * innovation, x[1] + K[1] * innovation];
        P = corrected(P, K, system);
      }
      out.x.push(x);
      out.P.push(P);
    }
    return out;
  }

  // The last measurements only; a lost one is replaced by its prediction, as in the package.
  function fir(z, { dt, H }, x0, own) {
    const used = [], out = [];
    let x = x0;
    z.forEach((each, k) => {
      const ahead = [x[0] + dt * x[1], x[1]];
      used.push(each ?? H[0] * ahead[0] + H[1] * ahead[1]);
      x = each === null ? ahead : [0, 1].map((i) => own.slice(0, k + 1).reduce((sum, tap, j) => sum + tap[i] * used[k - j], 0));
      out.push(x);
    });
    return out;
  }

  return { steadyState, order, taps, filter, fir };
})();
