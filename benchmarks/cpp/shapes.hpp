// Signed distances of the primitive shapes with their gradients, as in
// optipromp/core/geometry/distances.py.

#pragma once

#include <algorithm>
#include <cmath>

enum Kind { SPHERE, BOX, CYLINDER, CAPSULE };

struct Obstacle {
    int kind;
    double p[3], r[9], size[3], bound;
};

struct Distance {
    double d, x, y, z;
};

inline Distance box(double a, double b, double c, const double* h) {
    double s0 = std::copysign(1.0, a), s1 = std::copysign(1.0, b), s2 = std::copysign(1.0, c);
    double e0 = std::fabs(a) - h[0], e1 = std::fabs(b) - h[1], e2 = std::fabs(c) - h[2];
    double o0 = std::max(e0, 0.0), o1 = std::max(e1, 0.0), o2 = std::max(e2, 0.0);
    double outside = o0 * o0 + o1 * o1 + o2 * o2;
    if (outside > 1e-300) {
        double d = std::sqrt(outside), i = 1.0 / d;
        return {d, s0 * o0 * i, s1 * o1 * i, s2 * o2 * i};
    }
    if (e0 >= e1 && e0 >= e2) return {e0, s0, 0, 0};
    if (e1 >= e2) return {e1, 0, s1, 0};
    return {e2, 0, 0, s2};
}

inline Distance capsule(double a, double b, double c, double radius, double half) {
    double z = c - std::min(std::max(c, -half), half);
    double squared = a * a + b * b + z * z;
    if (squared <= 1e-300) return {-radius, 1, 0, 0};
    double d = std::sqrt(squared), i = 1.0 / d;
    return {d - radius, a * i, b * i, z * i};
}

inline Distance cylinder(double a, double b, double c, double radius, double half) {
    double squared = a * a + b * b, rho = 0, u0 = 1, u1 = 0;
    if (squared > 1e-300) {
        rho = std::sqrt(squared);
        u0 = a / rho;
        u1 = b / rho;
    }
    double side = std::copysign(1.0, c), radial = rho - radius, axial = std::fabs(c) - half;
    if (radial > 0 && axial > 0) {
        double d = std::sqrt(radial * radial + axial * axial), k = radial / d;
        return {d, k * u0, k * u1, side * axial / d};
    }
    if (radial >= axial) return {radial, u0, u1, 0};
    return {axial, 0, 0, side};
}

inline Distance signed_distance(const Obstacle& o, double x, double y, double z) {
    double d0 = x - o.p[0], d1 = y - o.p[1], d2 = z - o.p[2];
    if (o.kind == SPHERE) {
        double squared = d0 * d0 + d1 * d1 + d2 * d2, length = std::sqrt(squared);
        if (squared <= 1e-300) return {-o.size[0], 0, 0, 1};
        double i = 1.0 / length;
        return {length - o.size[0], d0 * i, d1 * i, d2 * i};
    }
    const double* r = o.r;
    double a = r[0] * d0 + r[3] * d1 + r[6] * d2;
    double b = r[1] * d0 + r[4] * d1 + r[7] * d2;
    double c = r[2] * d0 + r[5] * d1 + r[8] * d2;
    Distance l = o.kind == BOX       ? box(a, b, c, o.size)
                 : o.kind == CAPSULE ? capsule(a, b, c, o.size[0], o.size[1])
                                     : cylinder(a, b, c, o.size[0], o.size[1]);
    return {l.d, r[0] * l.x + r[1] * l.y + r[2] * l.z, r[3] * l.x + r[4] * l.y + r[5] * l.z,
            r[6] * l.x + r[7] * l.y + r[8] * l.z};
}
