// Even triangles on a closed surface: long edges split, short ones collapsed, diagonals flipped, corners moved within the
// surface towards the middle of their neighbours (M. Botsch, L. Kobbelt, "A remeshing approach to multiresolution
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

// Largest cosine of its angles, which is that of the one opposite the shortest edge: large where an angle is small
double sharpest(const Point &a, const Point &b, const Point &c) {
    const Point p = minus(b, a), q = minus(c, b), r = minus(a, c);
    const double pp = square(p), qq = square(q), rr = square(r);
    if (pp <= qq && pp <= rr) return -inner(q, r) / std::sqrt(qq * rr);
    return qq <= rr ? -inner(p, r) / std::sqrt(pp * rr) : -inner(p, q) / std::sqrt(pp * qq);
}

struct Mesh {
    std::vector<Point> x;
    std::vector<double> size;
    std::vector<Corners> f;  // first corner -1: removed
    std::vector<std::vector<std::int64_t>> at;
    std::size_t most;
    std::vector<std::int64_t> here, there;  // room for collapse

    bool alive(std::int64_t t) const { return f[t][0] >= 0; }
    void drop(std::int64_t v, std::int64_t t) { at[v].erase(std::find(at[v].begin(), at[v].end(), t)); }
    // Squared length of an edge over that wanted there
    double relative(std::int64_t a, std::int64_t b) const {
        const double wanted = 0.5 * (size[a] + size[b]);
        return square(minus(x[a], x[b])) / (wanted * wanted);
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
    void around(std::int64_t v, std::vector<std::int64_t> &found) const {
        found.clear();
        for (const std::int64_t t : at[v])
            for (int k = 0; k < 3; k++)
                if (f[t][k] == v) found.push_back(f[t][(k + 1) % 3]);
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
        around(a, here), around(b, there);
        int shared = 0;
        for (const std::int64_t v : here) shared += std::count(there.begin(), there.end(), v) > 0;
        if (shared != 2) return false;
        const Point m{0.5 * (x[a][0] + x[b][0]), 0.5 * (x[a][1] + x[b][1]), 0.5 * (x[a][2] + x[b][2])};
        for (const auto *ring : {&here, &there})
            for (const std::int64_t v : *ring) {
                const double wanted = longest * 0.5 * (size[v] + size[a]);
                if (v != a && v != b && !by_force && square(minus(x[v], m)) > wanted * wanted) return false;
            }
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

    // Flip the diagonal of two triangles, with the largest cosines in `sharp`, where that makes their smallest angle
    // larger; the other triangle, or -1 if not
    std::int64_t flip(std::int64_t t, int k, std::vector<double> &sharp) {
        const std::int64_t a = f[t][k], b = f[t][(k + 1) % 3], u = across(a, b);
        if (u < 0) return -1;
        const std::int64_t c = third(t, a, b), d = third(u, a, b);
        const double one = sharpest(x[a], x[d], x[c]), two = sharpest(x[d], x[b], x[c]);
        if (!(std::max(one, two) < std::max(sharp[t], sharp[u]) - 1e-3)) return -1;
        if (c == d || at[a].size() <= 3 || at[b].size() <= 3 || joined(c, d)) return -1;
        const Point now = normal(t), across_it = normal(u), three = area(x[a], x[d], x[c]), four = area(x[d], x[b], x[c]);
        Point mean{now[0] + across_it[0], now[1] + across_it[1], now[2] + across_it[2]};
        const double long_mean = std::sqrt(square(mean));
        for (const Point &face : {three, four})
            if (!(inner(face, mean) > 0.5 * long_mean * std::sqrt(square(face)))) return -1;
        if (!(inner(three, four) > upright * std::sqrt(square(three) * square(four)))) return -1;
        f[t] = {a, d, c}, f[u] = {d, b, c};
        sharp[t] = one, sharp[u] = two;
        drop(b, t), drop(a, u);
        at[d].push_back(t), at[c].push_back(u);
        return u;
    }
    void split_long() {
        for (std::int64_t t = 0; t < std::int64_t(f.size()); t++)
            for (int k = 0; k < 3; k++)
                if (f[t][k] < f[t][(k + 1) % 3] && relative(f[t][k], f[t][(k + 1) % 3]) > longest * longest)
                    split(t, k);
    }
    void collapse_short() {
        for (int sweep = 0; sweep < 4; sweep++) {
            std::int64_t done = 0;
            for (std::int64_t t = 0; t < std::int64_t(f.size()); t++)
                for (int k = 0; k < 3; k++)
                    if (alive(t) && f[t][k] < f[t][(k + 1) % 3] &&
                        relative(f[t][k], f[t][(k + 1) % 3]) < shortest * shortest)
                        done += collapse(t, k, false);
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
        std::vector<double> sharp(f.size(), 0);
        std::vector<std::int64_t> changed, last;
        for (std::int64_t t = 0; t < std::int64_t(f.size()); t++)
            if (alive(t)) sharp[t] = sharpest(x[f[t][0]], x[f[t][1]], x[f[t][2]]), last.push_back(t);
        for (int sweep = 0; sweep < 5 && !last.empty(); sweep++) {
            changed.clear();
            for (const std::int64_t t : last)
                for (int k = 0; k < 3; k++) {
                    if (sweep == 0 && f[t][k] > f[t][(k + 1) % 3]) continue;
                    const std::int64_t u = flip(t, k, sharp);
                    if (u >= 0) changed.push_back(t), changed.push_back(u);
                }
            last.swap(changed);
        }
    }
    void smooth(double share) {
        std::vector<Point> middle(x.size(), Point{0, 0, 0}), up = middle;
        std::vector<double> weight(x.size(), 0);
        for (const Corners &corners : f) {
            if (corners[0] < 0) continue;
            const Point &a = x[corners[0]], &b = x[corners[1]], &c = x[corners[2]];
            const Point n = area(a, b, c);
            const double s = (size[corners[0]] + size[corners[1]] + size[corners[2]]) / 3;
            const double w = std::sqrt(square(n)) / (s * s);
            for (const std::int64_t v : corners) {
                for (int d = 0; d < 3; d++) middle[v][d] += w * (a[d] + b[d] + c[d]) / 3, up[v][d] += n[d];
                weight[v] += w;
            }
        }
        for (std::size_t v = 0; v < x.size(); v++) {
            if (!(weight[v] > 0) || !(square(up[v]) > 0)) continue;
            Point way;
            for (int d = 0; d < 3; d++) way[d] = middle[v][d] / weight[v] - x[v][d];
            const double out = inner(way, up[v]) / square(up[v]);
            for (int d = 0; d < 3; d++) x[v][d] += share * (way[d] - out * up[v][d]);
        }
    }
};

}  // namespace

void grade_sizes(const double *vertices, const std::int64_t *triangles, std::int64_t count, double grading,
                 std::int64_t rounds, double *sizes) {
    std::vector<double> apart(3 * count);
    for (std::int64_t i = 0; i < 3 * count; i++) {
        const double *a = vertices + 3 * triangles[i], *b = vertices + 3 * triangles[i % 3 == 2 ? i - 2 : i + 1];
        const Point way{b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        apart[i] = grading * std::sqrt(square(way));
    }
    for (std::int64_t round = 0; round < rounds; round++)
        for (std::int64_t i = 0; i < 3 * count; i++) {
            double &one = sizes[triangles[i]], &two = sizes[triangles[i % 3 == 2 ? i - 2 : i + 1]];
            one = std::min(one, two + apart[i]);
            two = std::min(two, one + apart[i]);
        }
}

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
