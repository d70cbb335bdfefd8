/* The Kalman filter of one axis with measured positions, H = [1 0], in numbers: what a compiler makes of a plain loop.
   z has n measurements, NaN where one is missing; found takes n pairs of position and velocity. */
#include <math.h>

void kalman(const double *z, long n, double dt, const double *q, double r, double p, double *found)
{
    double s = 0, v = 0, p00 = p, p01 = 0, p11 = p;
    for (long k = 0; k < n; k++) {
        s += dt * v;
        p00 += dt * (2 * p01 + dt * p11) + q[0];
        p01 += dt * p11 + q[1];
        p11 += q[2];
        if (!isnan(z[k])) {
            double variance = p00 + r, k0 = p00 / variance, k1 = p01 / variance, surprise = z[k] - s;
            s += k0 * surprise;
            v += k1 * surprise;
            p11 -= k1 * p01;
            p01 -= k1 * p00;
            p00 -= k0 * p00;
        }
        found[2 * k] = s;
        found[2 * k + 1] = v;
    }
}
