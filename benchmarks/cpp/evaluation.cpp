// Cost and gradient of a trajectory in plain C++: what one evaluation of the joint strategy does
// (optipromp/core/optimization, evaluation.py and kernels.py), with the same arithmetic, for comparison.
//
//   evaluation FILE     reads the problem, then answers commands on standard input:
//     check             prints cost, values of the terms, and the gradient
//     time N            runs N evaluations, prints seconds for one
//     time-lean N       the same without the curvature that our kernels gather as they go
//     quit

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "problem.hpp"

static void outer(double* k, double w, double x, double y, double z) {
    k[0] += w * x * x;
    k[1] += w * y * y;
    k[2] += w * z * z;
    k[3] += w * x * y;
    k[4] += w * x * z;
    k[5] += w * y * z;
}

void Problem::kinematics() {
    for (size_t t = 0; t < T; ++t) {
        double r[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, o[3] = {0, 0, 0};
        for (size_t s = 0; s < S; ++s) {
            const Segment& g = chain[s];
            double m[9], e[9];
            for (int i = 0; i < 3; ++i)
                o[i] += r[3 * i] * g.translation[0] + r[3 * i + 1] * g.translation[1] +
                        r[3 * i + 2] * g.translation[2];
            for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j)
                    m[3 * i + j] = r[3 * i] * g.rotation[j] + r[3 * i + 1] * g.rotation[3 + j] +
                                   r[3 * i + 2] * g.rotation[6 + j];
            double x = g.axis[0], y = g.axis[1], z = g.axis[2];
            double c = std::cos(q[t * n + s]), k = std::sin(q[t * n + s]), v = 1.0 - c;
            e[0] = x * x * v + c, e[1] = x * y * v - z * k, e[2] = x * z * v + y * k;
            e[3] = x * y * v + z * k, e[4] = y * y * v + c, e[5] = y * z * v - x * k;
            e[6] = x * z * v - y * k, e[7] = y * z * v + x * k, e[8] = z * z * v + c;
            double* w = &axes[3 * (t * S + s)];
            for (int i = 0; i < 3; ++i) {
                w[i] = m[3 * i] * x + m[3 * i + 1] * y + m[3 * i + 2] * z;
                for (int j = 0; j < 3; ++j)
                    r[3 * i + j] = m[3 * i] * e[j] + m[3 * i + 1] * e[3 + j] + m[3 * i + 2] * e[6 + j];
            }
            std::copy(o, o + 3, &origins[3 * (t * S + s)]);
            std::copy(r, r + 9, &rotations[9 * (t * S + s)]);
        }
        for (size_t b = 0; b < P; ++b) {
            const double* l = &local[3 * b];
            double* out = point(t, b);
            if (segment[b] < 0) {
                std::copy(l, l + 3, out);
                continue;
            }
            const double* a = &rotations[9 * (t * S + segment[b])];
            const double* at = &origins[3 * (t * S + segment[b])];
            for (int i = 0; i < 3; ++i)
                out[i] = at[i] + a[3 * i] * l[0] + a[3 * i + 1] * l[1] + a[3 * i + 2] * l[2];
        }
    }
}

static bool apart(const double* a, const double* b, double far) {
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z >= far * far;
}

void Problem::measure(const std::vector<Obstacle>& all, size_t common, Field& out) const {
    for (size_t t = 0; t < T; ++t) {
        double* distance = &out.distance[t * B];
        double* normal = &out.normal[3 * t * B];
        std::fill(distance, distance + B, cutoff);
        std::fill(normal, normal + 3 * B, 0.0);
        for (size_t k = 0; k < all.size(); ++k) {
            const Obstacle& o = all[k];
            double reach = o.bound + cutoff;
            for (size_t link = 0; link < L; ++link) {
                if (k >= common && distal[link]) continue;
                if (apart(point(t, B + 2 + link), o.p, reach + bound[link])) continue;
                for (int b = start[link]; b < start[link + 1]; ++b) {
                    const double* x = point(t, b);
                    if (apart(x, o.p, reach + radius[b])) continue;
                    Distance found = signed_distance(o, x[0], x[1], x[2]);
                    double d = found.d - radius[b];
                    if (d < distance[b]) {
                        distance[b] = d;
                        normal[3 * b] = found.x;
                        normal[3 * b + 1] = found.y;
                        normal[3 * b + 2] = found.z;
                    }
                }
            }
        }
    }
}

template <bool Curvature> double Problem::obstacles(const Field& f, double weight, bool tool) {
    double total = 0;
    for (size_t t = 0; t < T; ++t) {
        double w = dt * (t == 0 || t == T - 1 ? 0.5 : 1.0);
        size_t before = t ? t - 1 : 0, after = std::min(t + 1, T - 1);
        double span = double(after - before) * dt;
        for (size_t link = 0; link < L; ++link) {
          if (!tool && distal[link]) continue;
          for (int b = start[link]; b < start[link + 1]; ++b) {
            double d = f.distance[t * B + b];
            if (d >= epsilon) continue;
            double c = d >= 0 ? (d - epsilon) * (d - epsilon) / (2 * epsilon) : 0.5 * epsilon - d;
            double slope = d >= 0 ? (d - epsilon) / epsilon : -1.0;
            const double *p0 = point(before, b), *p1 = point(after, b);
            double v[3], squared = 0;
            for (int i = 0; i < 3; ++i) v[i] = (p1[i] - p0[i]) / span, squared += v[i] * v[i];
            double speed = std::sqrt(squared);
            if (speed > 1e-12)
                for (double& a : v) a /= speed;
            else
                speed = v[0] = v[1] = v[2] = 0;
            total += w * c * speed;
            const double* normal = &f.normal[3 * (t * B + b)];
            double away = weight * w * slope * speed, drag = weight * w * c / span;
            for (int i = 0; i < 3; ++i) {
                pull(t, b)[i] += away * normal[i];
                pull(after, b)[i] += drag * v[i];
                pull(before, b)[i] -= drag * v[i];
            }
            if (Curvature)
                outer(stiff(t, b), weight * w * speed / epsilon, normal[0], normal[1], normal[2]);
          }
        }
    }
    return total;
}

template <bool Curvature> double Problem::push() {
    double total = 0;
    for (size_t t = first; t < T; ++t) {
        double w = dt * (t == first || t == T - 1 ? 0.5 : 1.0);
        const double* x = point(t, B);
        for (int a = 0; a < 3; ++a) {
            if (lever_push[a] == 0) continue;
            const double* f = &frame[3 * a];
            double off = f[0] * (x[0] - goal[0]) + f[1] * (x[1] - goal[1]) + f[2] * (x[2] - goal[2]);
            total += w * lever_push[a] * off * off;
            double k = 2 * weights[2] * w * lever_push[a];
            for (int i = 0; i < 3; ++i) pull(t, B)[i] += k * off * f[i];
            if (Curvature) outer(stiff(t, B), k, f[0], f[1], f[2]);
        }
    }
    return total;
}

template <bool Curvature> double Problem::velocity() {
    double total = 0, k = 2 * weights[3] / dt;
    for (size_t t = 0; t + 1 < T; ++t)
        for (size_t j = 0; j < n; ++j) {
            double step = q[(t + 1) * n + j] - q[t * n + j];
            total += step * step / dt;
            gradient[(t + 1) * n + j] += k * step;
            gradient[t * n + j] -= k * step;
            if (Curvature) {
                band[(3 * t) * n + j] += k;
                band[(3 * (t + 1)) * n + j] += k;
                band[(3 * t + 1) * n + j] -= k;
            }
        }
    return total;
}

template <bool Curvature> double Problem::self() {
    double total = 0, weight = weights[4];
    for (size_t t = 0; t < T; ++t)
        for (size_t g = 0; g < groups.size(); g += 4) {
            int one = groups[g], two = groups[g + 1], last = -1;
            const double* other = point(t, B + 2 + two);
            if (apart(point(t, B + 2 + one), other, bound[one] + bound[two] + margin)) continue;
            bool skip = false;
            for (int p = groups[g + 2]; p < groups[g + 3]; ++p) {
                int i = pairs[2 * p], j = pairs[2 * p + 1];
                if (i != last) {
                    last = i;
                    skip = apart(point(t, i), other, radius[i] + bound[two] + margin);
                }
                if (skip) continue;
                const double *a = point(t, i), *b = point(t, j);
                double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
                double keep = radius[i] + radius[j] + margin, squared = x * x + y * y + z * z;
                if (squared >= keep * keep) continue;
                double length = std::sqrt(squared), missing = keep - length;
                total += 0.5 * weight * missing * missing;
                if (length < 1e-9) continue;
                x /= length, y /= length, z /= length;
                double k = weight * missing, *u = pull(t, i), *v = pull(t, j);
                u[0] -= k * x, u[1] -= k * y, u[2] -= k * z;
                v[0] += k * x, v[1] += k * y, v[2] += k * z;
                if (Curvature) {
                    outer(stiff(t, i), 2 * weight, x, y, z);
                    outer(stiff(t, j), 2 * weight, x, y, z);
                }
            }
        }
    return total;
}

void Problem::pull_back() {
    std::vector<double> wrench(6 * S);
    for (size_t t = 0; t < T; ++t) {
        std::fill(wrench.begin(), wrench.end(), 0.0);
        for (size_t b = 0; b < B + 2; ++b) {
            const double *f = pull(t, b), *x = point(t, b);
            if (segment[b] < 0 || (f[0] == 0 && f[1] == 0 && f[2] == 0)) continue;
            double* w = &wrench[6 * segment[b]];
            w[0] += f[0], w[1] += f[1], w[2] += f[2];
            w[3] += x[1] * f[2] - x[2] * f[1];
            w[4] += x[2] * f[0] - x[0] * f[2];
            w[5] += x[0] * f[1] - x[1] * f[0];
        }
        double a[6] = {0, 0, 0, 0, 0, 0};
        for (size_t s = S; s-- > 0;) {
            for (int i = 0; i < 6; ++i) a[i] += wrench[6 * s + i];
            const double *w = &axes[3 * (t * S + s)], *o = &origins[3 * (t * S + s)];
            gradient[t * n + s] += w[0] * (a[3] - (o[1] * a[2] - o[2] * a[1])) +
                                   w[1] * (a[4] - (o[2] * a[0] - o[0] * a[2])) +
                                   w[2] * (a[5] - (o[0] * a[1] - o[1] * a[0]));
        }
    }
    std::fill_n(gradient.begin(), n, 0.0);  // the start is given
}

template <bool Curvature> void Problem::clear() {
    std::fill(force.begin(), force.end(), 0.0);
    std::fill(gradient.begin(), gradient.end(), 0.0);
    if (Curvature) {
        std::fill(stiffness.begin(), stiffness.end(), 0.0);
        std::fill(band.begin(), band.end(), 0.0);
    }
}

template <bool Curvature> double Problem::evaluate() {
    kinematics();
    clear<Curvature>();
    measure(fixed, fixed.size(), near_fixed);
    measure(moving, shared, near_moving);
    terms[0] = obstacles<Curvature>(near_fixed, weights[0], true);
    terms[1] = obstacles<Curvature>(near_moving, weights[1], false);
    terms[2] = push<Curvature>();
    terms[3] = velocity<Curvature>();
    terms[4] = self<Curvature>();
    pull_back();
    double cost = terms[4];  // a constraint comes with its weight
    for (int i = 0; i < 4; ++i) cost += weights[i] * terms[i];
    return cost;
}

template <bool Curvature> static double seconds(Problem& problem, int runs) {
    volatile double sink = 0;
    auto began = std::chrono::steady_clock::now();
    for (int i = 0; i < runs; ++i) sink = sink + problem.evaluate<Curvature>();
    std::chrono::duration<double> passed = std::chrono::steady_clock::now() - began;
    return passed.count() / runs;
}

int main(int count, char** words) try {
    if (count != 2) throw std::runtime_error("usage: evaluation FILE");
    Problem problem(read(words[1]));
    std::string command;
    while (std::cin >> command && command != "quit") {
        int runs = 1;
        if (command == "check") {
            std::printf("%.17g", problem.evaluate<true>());
            for (double v : problem.terms) std::printf(" %.17g", v);
            for (double v : problem.gradient) std::printf(" %.17g", v);
            std::printf("\n");
        } else if (command == "time" && std::cin >> runs) {
            std::printf("%.9g\n", seconds<true>(problem, runs));
        } else if (command == "time-lean" && std::cin >> runs) {
            std::printf("%.9g\n", seconds<false>(problem, runs));
        } else {
            throw std::runtime_error("unknown command " + command);
        }
        std::fflush(stdout);
    }
} catch (const std::exception& error) {
    std::fprintf(stderr, "evaluation: %s\n", error.what());
    return 1;
}
