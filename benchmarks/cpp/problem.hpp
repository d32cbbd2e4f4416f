// The problem as benchmarks/evaluation.py writes it: lines "name count v1 v2 ...".

#pragma once

#include <algorithm>
#include <fstream>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "shapes.hpp"

using Numbers = std::vector<double>;

inline std::map<std::string, Numbers> read(const char* path) {
    std::ifstream in(path);
    std::map<std::string, Numbers> out;
    std::string name;
    size_t count;
    while (in >> name >> count) {
        Numbers values(count);
        for (double& v : values) {
            std::string word;
            if (!(in >> word)) throw std::runtime_error(name + ": too few values");
            v = std::stod(word);
        }
        out[name] = values;
    }
    return out;
}

struct Segment {
    double rotation[9], translation[3], axis[3];
};

struct Field {
    Numbers distance, normal;
};

class Problem {
  public:
    explicit Problem(std::map<std::string, Numbers> data);
    template <bool Curvature> double evaluate();
    Numbers gradient, terms;

  private:
    template <bool Curvature> void clear();
    void kinematics();
    void measure(const std::vector<Obstacle>& obstacles, size_t shared, Field& out) const;
    template <bool Curvature> double obstacles(const Field& f, double weight, bool tool);
    template <bool Curvature> double push();
    template <bool Curvature> double velocity();
    template <bool Curvature> double self();
    void pull_back();

    double* point(size_t t, size_t b) { return &points[3 * (t * P + b)]; }
    const double* point(size_t t, size_t b) const { return &points[3 * (t * P + b)]; }
    double* pull(size_t t, size_t b) { return &force[3 * (t * (B + 2) + b)]; }
    double* stiff(size_t t, size_t b) { return &stiffness[6 * (t * (B + 2) + b)]; }

    size_t T, n, S, B, L, P, first, shared;
    double dt, cutoff, epsilon, margin, lever_push[3], weights[5];
    Numbers goal, frame, q, local, radius, bound;
    std::vector<int> segment, start, distal, groups, pairs;
    std::vector<Segment> chain;
    std::vector<Obstacle> fixed, moving;
    Numbers origins, rotations, axes, points, force, stiffness, band;
    Field near_fixed, near_moving;
};

inline std::vector<int> whole(const Numbers& v) { return std::vector<int>(v.begin(), v.end()); }

inline std::vector<Obstacle> obstacles_from(const Numbers& v) {
    std::vector<Obstacle> out(v.size() / 17);
    for (size_t k = 0; k < out.size(); ++k) {
        const double* at = &v[17 * k];
        out[k].kind = int(at[0]);
        std::copy(at + 1, at + 4, out[k].p);
        std::copy(at + 4, at + 13, out[k].r);
        std::copy(at + 13, at + 16, out[k].size);
        out[k].bound = at[16];
    }
    return out;
}

inline Problem::Problem(std::map<std::string, Numbers> d) {
    auto number = [&](const char* name) { return d.at(name).at(0); };
    n = size_t(number("joints"));
    q = d.at("q");
    T = q.size() / n;
    S = d.at("axis").size() / 3;
    radius = d.at("radius");
    bound = d.at("link_bound");
    local = d.at("local");
    B = radius.size();
    L = bound.size();
    P = local.size() / 3;
    first = size_t(number("first"));
    shared = size_t(number("shared"));
    dt = number("dt");
    cutoff = number("cutoff");
    epsilon = number("epsilon");
    margin = number("self_margin");
    std::copy_n(d.at("weights").begin(), 5, weights);
    std::copy_n(d.at("push_weights").begin(), 3, lever_push);
    goal = d.at("goal");
    frame = d.at("frame");
    segment = whole(d.at("segment"));
    start = whole(d.at("link_start"));
    distal = whole(d.at("link_distal"));
    groups = whole(d.at("groups"));
    pairs = whole(d.at("pairs"));
    chain.resize(S);
    for (size_t s = 0; s < S; ++s) {
        std::copy_n(&d.at("rotation")[9 * s], 9, chain[s].rotation);
        std::copy_n(&d.at("translation")[3 * s], 3, chain[s].translation);
        std::copy_n(&d.at("axis")[3 * s], 3, chain[s].axis);
    }
    fixed = obstacles_from(d.at("static"));
    moving = obstacles_from(d.at("dynamic"));
    origins.resize(T * S * 3);
    rotations.resize(T * S * 9);
    axes.resize(T * S * 3);
    points.resize(T * P * 3);
    force.resize(T * (B + 2) * 3);
    stiffness.resize(T * (B + 2) * 6);
    band.resize(T * 3 * n);
    gradient.resize(T * n);
    terms.resize(5);
    for (Field* f : {&near_fixed, &near_moving}) {
        f->distance.resize(T * B);
        f->normal.resize(T * B * 3);
    }
}
