// Even triangles on a closed skin: long edges split, short ones collapsed, diagonals flipped, corners moved within the
// skin towards the middle of their neighbours (M. Botsch, L. Kobbelt, "A remeshing approach to multiresolution
// modeling", Symposium on Geometry Processing 2004). Nothing here opens the mesh or turns a triangle over.
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "kernels.hpp"

namespace airtact {
namespace AIRTACT_VARIANT {
namespace {

using Point = std::array<double, 3>;
using Corners = std::array<std::int64_t, 3>;

constexpr double longest = 1.4, shortest = 0.7;  // edges over the size asked for
constexpr double upright = 0.3;                  // cosine by which a triangle may turn

Point minus(const Point &a, const Point &b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
double inner(const Point &a, const Point &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Point outer(const Point &a, const Point &b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
double square(const Point &a) { return inner(a, a); }
Point area(const Point &a, const Point &b, const Point &c) { return outer(minus(b, a), minus(c, a)); }

// Twice the area over the squared longest edge: small for every kind of bad triangle, 0.87 for an equilateral one
double shape(const Point &a, const Point &b, const Point &c) {
    const double edge = std::max({square(minus(b, a)), square(minus(c, b)), square(minus(a, c))});
    return edge > 0 ? std::sqrt(square(area(a, b, c))) / edge : 0;
}

// Largest cosine of its angles: large for a triangle with a small angle
double sharpest(const Point &a, const Point &b, const Point &c) {
    const Point p = minus(b, a), q = minus(c, b), r = minus(a, c);
    const double pp = square(p), qq = square(q), rr = square(r);
    return std::max({-inner(p, r) / std::sqrt(pp * rr), -inner(p, q) / std::sqrt(pp * qq),
                     -inner(q, r) / std::sqrt(qq * rr)});
}

struct Mesh {
    std::vector<Point> x;
    std::vector<double> size;
    std::vector<Corners> f;  // first corner -1: removed
    std::vector<std::vector<std::int64_t>> at;
    std::size_t most;

    bool alive(std::int64_t t) const { return f[t][0] >= 0; }
    void drop(std::int64_t v, std::int64_t t) { at[v].erase(std::find(at[v].begin(), at[v].end(), t)); }
    double relative(std::int64_t a, std::int64_t b) const {
        return std::sqrt(square(minus(x[a], x[b]))) / (0.5 * (size[a] + size[b]));
    }
    // The other triangle of edge a b, which runs b a there; -1 if none
    std::int64_t across(std::int64_t a, std::int64_t b) const {
        for (const std::int64_t t : at[b])
            for (int k = 0; k < 3; k++)
                if (f[t][k] == b && f[t][(k + 1) % 3] == a) return t;
        return -1;
    }
    std::int64_t third(std::int64_t t, std::int64_t a, std::int64_t b) const {
        for (int k = 0; k < 3; k++)
            if (f[t][k] != a && f[t][k] != b) return f[t][k];
        return -1;
    }
    std::vector<std::int64_t> around(std::int64_t v) const {
        std::vector<std::int64_t> found;
        found.reserve(at[v].size());
        for (const std::int64_t t : at[v])
            for (int k = 0; k < 3; k++)
                if (f[t][k] == v) found.push_back(f[t][(k + 1) % 3]);
        return found;
    }
    bool joined(std::int64_t a, std::int64_t b) const {
        for (const std::int64_t t : at[a])
            for (int k = 0; k < 3; k++)
                if (f[t][k] == b) return true;
        return false;
    }
    Point normal(std::int64_t t) const { return area(x[f[t][0]], x[f[t][1]], x[f[t][2]]); }

    bool split(std::int64_t t, int k) {
        if (x.size() >= most || f.size() + 2 > 2 * most) return false;
        const std::int64_t a = f[t][k], b = f[t][(k + 1) % 3], u = across(a, b);
        if (u < 0) return false;
        const std::int64_t c = third(t, a, b), d = third(u, a, b), m = std::int64_t(x.size());
        x.push_back({0.5 * (x[a][0] + x[b][0]), 0.5 * (x[a][1] + x[b][1]), 0.5 * (x[a][2] + x[b][2])});
        size.push_back(0.5 * (size[a] + size[b]));
        at.push_back({});
        const std::int64_t v = std::int64_t(f.size()), w = v + 1;
        f[t] = {a, m, c}, f[u] = {m, a, d};
        f.push_back({m, b, c}), f.push_back({b, m, d});
        drop(b, t), drop(b, u);
        at[b].push_back(v), at[b].push_back(w), at[c].push_back(v), at[d].push_back(w);
        at[m] = {t, u, v, w};
        return true;
    }

    bool collapse(std::int64_t t, int k, bool by_force) {
        const std::int64_t a = f[t][k], b = f[t][(k + 1) % 3], u = across(a, b);
        if (u < 0) return false;
        const std::int64_t c = third(t, a, b), d = third(u, a, b);
        if (c == d || at[c].size() <= 3 || at[d].size() <= 3 || at[a].size() + at[b].size() < 7) return false;
        const std::vector<std::int64_t> here = around(a), there = around(b);
        int shared = 0;
        for (const std::int64_t v : here) shared += std::count(there.begin(), there.end(), v) > 0;
        if (shared != 2) return false;
        const Point m{0.5 * (x[a][0] + x[b][0]), 0.5 * (x[a][1] + x[b][1]), 0.5 * (x[a][2] + x[b][2])};
        for (const auto &ring : {here, there})
            for (const std::int64_t v : ring)
                if (v != a && v != b && !by_force && std::sqrt(square(minus(x[v], m))) > longest * 0.5 * (size[v] + size[a]))
                    return false;
        for (const std::int64_t end : {a, b})
            for (const std::int64_t s : at[end]) {
                if (s == t || s == u) continue;
                Point p[3];
                for (int i = 0; i < 3; i++) p[i] = f[s][i] == end ? m : x[f[s][i]];
                const Point before = normal(s), after = area(p[0], p[1], p[2]);
                const double sizes = std::sqrt(square(before) * square(after));
                const bool sliver = shape(x[f[s][0]], x[f[s][1]], x[f[s][2]]) < 0.1;
                if (!(sizes > 0) || (!sliver && inner(before, after) < upright * sizes)) return false;
                if (shape(p[0], p[1], p[2]) < (sliver ? 0.02 : 0.15)) return false;
            }
        x[a] = m;
        size[a] = 0.5 * (size[a] + size[b]);
        for (const std::int64_t s : {t, u}) {
            for (int i = 0; i < 3; i++)
                if (f[s][i] != b) drop(f[s][i], s);
            f[s][0] = -1;
        }
        for (const std::int64_t s : at[b]) {
            if (s == t || s == u) continue;
            for (int i = 0; i < 3; i++)
                if (f[s][i] == b) f[s][i] = a;
            at[a].push_back(s);
        }
        at[b].clear();
        return true;
    }

    // Flip the diagonal of two triangles where that makes their smallest angle larger
    bool flip(std::int64_t t, int k) {
        const std::int64_t a = f[t][k], b = f[t][(k + 1) % 3], u = across(a, b);
        if (u < 0) return false;
        const std::int64_t c = third(t, a, b), d = third(u, a, b);
        if (c == d || at[a].size() <= 3 || at[b].size() <= 3 || joined(c, d)) return false;
        const double now = std::max(sharpest(x[a], x[b], x[c]), sharpest(x[b], x[a], x[d]));
        const double then = std::max(sharpest(x[a], x[d], x[c]), sharpest(x[d], x[b], x[c]));
        if (!(then < now - 1e-3)) return false;
        const Point one = normal(t), two = normal(u), three = area(x[a], x[d], x[c]), four = area(x[d], x[b], x[c]);
        Point mean{one[0] + two[0], one[1] + two[1], one[2] + two[2]};
        const double long_mean = std::sqrt(square(mean));
        for (const Point &face : {three, four})
            if (!(inner(face, mean) > 0.5 * long_mean * std::sqrt(square(face)))) return false;
        if (!(inner(three, four) > upright * std::sqrt(square(three) * square(four)))) return false;
        f[t] = {a, d, c}, f[u] = {d, b, c};
        drop(b, t), drop(a, u);
        at[d].push_back(t), at[c].push_back(u);
        return true;
    }
    void split_long() {
        for (std::int64_t t = 0; t < std::int64_t(f.size()); t++)
            for (int k = 0; k < 3; k++)
                if (alive(t) && relative(f[t][k], f[t][(k + 1) % 3]) > longest) split(t, k);
    }
    void collapse_short() {
        for (int sweep = 0; sweep < 4; sweep++) {
            std::int64_t done = 0;
            for (std::int64_t t = 0; t < std::int64_t(f.size()); t++)
                for (int k = 0; k < 3; k++)
                    if (alive(t) && relative(f[t][k], f[t][(k + 1) % 3]) < shortest) done += collapse(t, k, false);
            if (done < std::int64_t(f.size()) / 500 + 1) break;
        }
    }
    // The shortest edge of a needle collapses, whatever the sizes say
    void collapse_needles(double least) {
        for (std::int64_t t = 0; t < std::int64_t(f.size()); t++) {
            if (!alive(t) || sharpest(x[f[t][0]], x[f[t][1]], x[f[t][2]]) < least) continue;
            int k = 0;
            double best = relative(f[t][0], f[t][1]);
            for (int i = 1; i < 3; i++)
                if (relative(f[t][i], f[t][(i + 1) % 3]) < best) best = relative(f[t][i], f[t][(i + 1) % 3]), k = i;
            collapse(t, k, true);
        }
    }
    void flip_better() {
        for (int sweep = 0; sweep < 5; sweep++) {
            std::int64_t done = 0;
            for (std::int64_t t = 0; t < std::int64_t(f.size()); t++)
                for (int k = 0; k < 3; k++)
                    if (alive(t)) done += flip(t, k);
            if (done == 0) break;
        }
    }
    void smooth(double share) {
        std::vector<Point> moved = x;
        for (std::size_t v = 0; v < x.size(); v++) {
            if (at[v].empty()) continue;
            Point sum{0, 0, 0}, up{0, 0, 0};
            double weight = 0;
            for (const std::int64_t t : at[v]) {
                const Point n = normal(t);
                const double s = (size[f[t][0]] + size[f[t][1]] + size[f[t][2]]) / 3;
                const double w = std::sqrt(square(n)) / (s * s);
                for (int d = 0; d < 3; d++) {
                    sum[d] += w * (x[f[t][0]][d] + x[f[t][1]][d] + x[f[t][2]][d]) / 3;
                    up[d] += n[d];
                }
                weight += w;
            }
            if (!(weight > 0) || !(square(up) > 0)) continue;
            Point way{sum[0] / weight - x[v][0], sum[1] / weight - x[v][1], sum[2] / weight - x[v][2]};
            const double out = inner(way, up) / square(up);
            for (int d = 0; d < 3; d++) moved[v][d] = x[v][d] + share * (way[d] - out * up[d]);
        }
        x = moved;
    }
};

}  // namespace

void even_pass(double *vertices, double *sizes, std::int64_t most, std::int64_t *triangles, std::int64_t *counts,
               bool keep, double needle, double share) {
    Mesh mesh;
    mesh.most = most;
    mesh.x.resize(counts[0]), mesh.size.resize(counts[0]), mesh.at.resize(counts[0]), mesh.f.resize(counts[1]);
    for (std::int64_t v = 0; v < counts[0]; v++) {
        for (int d = 0; d < 3; d++) mesh.x[v][d] = vertices[3 * v + d];
        mesh.size[v] = sizes[v];
        mesh.at[v].reserve(8);
    }
    for (std::int64_t t = 0; t < counts[1]; t++)
        for (int k = 0; k < 3; k++) {
            mesh.f[t][k] = triangles[3 * t + k];
            mesh.at[mesh.f[t][k]].push_back(t);
        }
    if (!keep) {
        mesh.split_long();
        mesh.collapse_short();
        if (needle < 1) mesh.collapse_needles(needle);
        mesh.flip_better();
    }
    mesh.smooth(share);
    std::vector<std::int64_t> place(mesh.x.size(), -1);
    counts[0] = counts[1] = 0;
    for (std::size_t v = 0; v < mesh.x.size(); v++) {
        if (mesh.at[v].empty()) continue;
        place[v] = counts[0]++;
        for (int d = 0; d < 3; d++) vertices[3 * place[v] + d] = mesh.x[v][d];
        sizes[place[v]] = mesh.size[v];
    }
    for (std::size_t t = 0; t < mesh.f.size(); t++) {
        if (!mesh.alive(t)) continue;
        for (int k = 0; k < 3; k++) triangles[3 * counts[1] + k] = place[mesh.f[t][k]];
        counts[1]++;
    }
}

}  // namespace AIRTACT_VARIANT
}  // namespace airtact
