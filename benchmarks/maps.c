/* The plain loops over maps of tiles that the kernels are measured against: registering, integrating, searching.
   Arrays are C-contiguous; angles in rad, lengths in metres where nothing else is said. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

/* Maps of tiles as of kernels/tiles.py: 32 x 32 fine cells of int16 and behind them 16 x 16 coarse ones; in a cell the
   distance in 1/1023 truncations, and in the lowest 5 bits its weight. */
enum { BITS = 5, SIDE = 1 << BITS, TILE = SIDE * SIDE * 5 / 4, STEPS = 1023, WEIGHT = 31 };

typedef struct {
    const int16_t *pool;
    const int *table;
    int columns, rows;
} Map;

static inline int address(const Map *map, int x, int y, int level)
{
    const int shift = BITS - level, mask = (SIDE >> level) - 1;
    const int tile = map->table[(y >> shift) * map->columns + (x >> shift)];
    return tile * TILE + level * SIDE * SIDE + ((y & mask) << shift) + (x & mask);
}

static inline int cell_at(const Map *map, int x, int y, int level)
{
    return map->pool[address(map, x, y, level)];
}

/* Distance [steps], its derivatives by a cell and whether it is known, between the four cells around a place. */
static inline int between(const Map *map, float x, float y, int level, float *d)
{
    const float last_x = (map->columns * SIDE >> level) - 2, last_y = (map->rows * SIDE >> level) - 2;
    x = fminf(fmaxf(x, 1.0f), last_x) - 0.5f, y = fminf(fmaxf(y, 1.0f), last_y) - 0.5f;
    const int ix = (int)x, iy = (int)y;
    const float fx = x - ix, fy = y - iy;
    const int a = cell_at(map, ix, iy, level), b = cell_at(map, ix + 1, iy, level);
    const int c = cell_at(map, ix, iy + 1, level), e = cell_at(map, ix + 1, iy + 1, level);
    const float da = a >> 5, db = b >> 5, dc = c >> 5, de = e >> 5;
    const float low = da + fx * (db - da), high = dc + fx * (de - dc);
    d[0] = low + fy * (high - low);
    d[1] = (db - da) + fy * ((de - dc) - (db - da));
    d[2] = high - low;
    return (a & WEIGHT) && (b & WEIGHT) && (c & WEIGHT) && (e & WEIGHT);
}

/* The symmetric system h x = b by Cholesky; h holds 00 01 02 11 12 22. */
static void cholesky(const float *h, const float *b, float *x)
{
    const float l00 = sqrtf(h[0]), l10 = h[1] / l00, l20 = h[2] / l00;
    const float l11 = sqrtf(fmaxf(h[3] - l10 * l10, 1e-9f)), l21 = (h[4] - l20 * l10) / l11;
    const float l22 = sqrtf(fmaxf(h[5] - l20 * l20 - l21 * l21, 1e-9f));
    const float y0 = b[0] / l00, y1 = (b[1] - l10 * y0) / l11, y2 = (b[2] - l20 * y0 - l21 * y1) / l22;
    x[2] = y2 / l22;
    x[1] = (y1 - l21 * x[2]) / l11;
    x[0] = (y0 - l10 * x[1] - l20 * x[2]) / l00;
}

/* What Gauss-Newton has of an endpoint (rx, ry) from the robot [cells]: residual and derivatives by its place and heading
   in the map. */
static inline void add(float *h, const float *d, float rx, float ry)
{
    const float jt = d[2] * rx - d[1] * ry;
    h[0] += d[1] * d[1], h[1] += d[1] * d[2], h[2] += d[1] * jt, h[3] += d[2] * d[2], h[4] += d[2] * jt, h[5] += jt * jt;
    h[6] -= d[1] * d[0], h[7] -= d[2] * d[0], h[8] -= jt * d[0];
}

/* The same sums by an offset from the frame, in its directions [m], of residuals in standard deviations. */
static void turn(float *h, const float *f, float inverse, float scale)
{
    const float c = f[0] * inverse * scale, s = f[1] * inverse * scale;
    const float both = 2 * c * s * h[1], xx = h[0], yy = h[3], xt = h[2], yt = h[4], x = h[6], y = h[7];
    h[0] = c * c * xx + both + s * s * yy, h[3] = s * s * xx - both + c * c * yy;
    h[1] = c * s * (yy - xx) + (c * c - s * s) * h[1];
    h[2] = (c * xt + s * yt) * scale, h[4] = (c * yt - s * xt) * scale, h[5] *= scale * scale;
    h[6] = (c * x + s * y) * scale, h[7] = (c * y - s * x) * scale, h[8] *= scale * scale;
}

/* The robot's pose in the map, moved by an offset: cos and sin of its heading [cells/m], x and y [cells]. */
static void place(const float *f, const float *o, float inverse, float *p)
{
    const float c = cosf(o[2]), s = sinf(o[2]);
    p[0] = (f[0] * c - f[1] * s) * inverse, p[1] = (f[1] * c + f[0] * s) * inverse;
    p[2] = (f[0] * o[0] - f[1] * o[1] + f[2]) * inverse, p[3] = (f[1] * o[0] + f[0] * o[1] + f[3]) * inverse;
}

/* A step's length, as a multiple of 0.3 mm or 0.1 mrad. */
static float length_of(float x, float y, float theta)
{
    return fmaxf((fabsf(x) + fabsf(y)) / 3e-4f, fabsf(theta) / 1e-4f);
}

/* A scan of k points (x, then y) registered to the maps of n particles, from frames [n, 4] (cos, sin, x, y [m]) and a
   prior of these inverse variances: Gauss-Newton on the coarse level, then on the fine one, which ends where the steps
   still to come are short or the last two undo each other; then the fit there: cost, likelihood, and rays that cross a
   surface. Writes offset, information, these three, and how many times the scan was
   gone through: [n, 13]. */
void register_all(const int16_t *pool, const int *tables, int rows, int columns, const double *frames, int n,
                  const float *scan, int k, const float *prior, float cell, float truncation, float coarse_truncation,
                  float sd, int iterations, double *out)
{
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        const Map map = {pool, tables + (size_t)i * rows * columns, columns, rows};
        const float f[4] = {frames[4 * i], frames[4 * i + 1], frames[4 * i + 2], frames[4 * i + 3]};
        float o[3] = {0}, d[3], h[9], p[4];
        int passes = 1;
        for (int level = 1; level >= 0; level--) {
            const float inverse = 1 / (cell * (1 << level)), wide = level ? 10.0f : 1.0f;
            const float scale = (level ? coarse_truncation / (2 * sd) : truncation / sd) / STEPS;
            float x[3], last[3] = {0}, before = 0;
            for (int step = 0, done = 0; step < iterations && !done; step++) {
                passes++;
                place(f, o, inverse, p);
                for (int j = 0; j < 9; j++)
                    h[j] = 0;
                for (int j = 0; j < k; j++) {
                    const float rx = p[0] * scan[j] - p[1] * scan[k + j], ry = p[1] * scan[j] + p[0] * scan[k + j];
                    if (between(&map, rx + p[2], ry + p[3], level, d))
                        add(h, d, rx, ry);
                }
                turn(h, f, inverse, scale);
                h[0] += prior[0], h[3] += prior[1], h[5] += prior[2];
                for (int j = 0; j < 3; j++)
                    h[6 + j] -= prior[j] * o[j];
                cholesky(h, h + 6, x);
                const float length = length_of(x[0], x[1], x[2]);
                float share = 1;
                if (length < wide || length * length < wide * (before - length)) {
                    done = 1;
                } else if (length_of(x[0] + last[0], x[1] + last[1], x[2] + last[2]) < wide) {
                    share = 0.5f;
                    done = 1;
                }
                for (int j = 0; j < 3; j++)
                    o[j] += share * x[j], last[j] = x[j];
                before = length;
            }
        }
        const float inverse = 1 / cell, scale = truncation / sd / STEPS, clear = 2 * truncation * inverse;
        float cost = 0, likely = 0, crossed = 0;
        place(f, o, inverse, p);
        for (int j = 0; j < 9; j++)
            h[j] = 0;
        for (int j = 0; j < k; j++) {
            const float rx = p[0] * scan[j] - p[1] * scan[k + j], ry = p[1] * scan[j] + p[0] * scan[k + j];
            const float px = rx + p[2], py = ry + p[3];
            float r = 0;
            int seen = between(&map, px, py, 0, d);
            if (seen) {
                r = d[0] * scale;
                add(h, d, rx, ry);
            } else {
                seen = between(&map, 0.5f * px, 0.5f * py, 1, d);
                r = d[0] * coarse_truncation / sd / STEPS;
            }
            cost += seen ? fminf(0.5f * r * r, 8.0f) : 2.0f;
            likely += seen ? expf(-0.125f * r * r) : 0;
            const float length = sqrtf(rx * rx + ry * ry);
            int hit = 0;
            for (int m = 0; m < 6; m++) {
                const float share = 0.9f - 0.15f * m;
                if ((1 - share) * length > clear) {
                    const int word = cell_at(&map, (int)(p[2] + share * rx), (int)(p[3] + share * ry), 0);
                    hit |= (word & WEIGHT) > 4 && abs(word >> 5) < STEPS / 3;
                }
            }
            crossed += hit;
        }
        turn(h, f, inverse, scale);
        for (int j = 0; j < 3; j++)
            out[13 * i + j] = o[j];
        for (int j = 0; j < 6; j++)
            out[13 * i + 3 + j] = h[j];
        out[13 * i + 9] = cost, out[13 * i + 10] = likely, out[13 * i + 11] = crossed;
        out[13 * i + 12] = passes;
    }
}

/* Averages the signed distances to the segment from a to b [cells of the level] into the cells within the truncation of
   it, on lines of cells across the segment. */
static void average(const Map *map, int16_t *pool, float ax, float ay, float bx, float by, float truncation, float near,
                    int near_weight, int max_weight, int level)
{
    const float overlap = 0.25f, slack = 0.49f, dx = bx - ax, dy = by - ay, length = sqrtf(dx * dx + dy * dy);
    const float ux = dx / length, uy = dy / length, inverse = 1 / truncation, nearer = near * inverse;
    const int flat = fabsf(ux) > fabsf(uy), mask = (SIDE >> level) - 1, stride = flat ? SIDE >> level : 1;
    /* o counts the lines, i the cells of a line; the distance [truncations] grows by vo and vi along them */
    const float ao = flat ? ax : ay, bo = flat ? bx : by, uo = flat ? ux : uy, vo = (flat ? -uy : ux) * inverse;
    const float ai = flat ? ay : ax, ui = flat ? uy : ux, vi = (flat ? ux : -uy) * inverse;
    const float slope = ui / uo, half = truncation / fabsf(uo), beyond = overlap * fabsf(uo) + truncation * fabsf(ui);
    const int slanted = fabsf(ui) > 1e-3f;
    const float back = slanted ? -uo / ui : 0, reach = slanted ? (0.5f * length + overlap) / fabsf(ui) : 1e6f;
    const float middle = slanted ? 0.5f * length / ui : 0;
    const int begin = (int)(fminf(ao, bo) - beyond + slack), end = (int)(fmaxf(ao, bo) + beyond - slack);
    for (int o = begin; o <= end; o++) {
        const float line = o + 0.5f - ao, across = line * slope, along_at = line * back + middle;
        const int last = (int)(fminf(across + half, along_at + reach) + ai - slack);
        for (int i = (int)(fmaxf(across - half, along_at - reach) + ai + slack); i <= last;) {
            const int edge = (i | mask) < last ? i | mask : last; /* up to there the line lies in one tile */
            int16_t *cell = pool + address(map, flat ? o : i, flat ? i : o, level);
            for (; i <= edge; i++, cell += stride) {
                const float place = i + 0.5f - ai, along = line * uo + place * ui, distance = line * vo + place * vi;
                if (along < -overlap || along > length + overlap || fabsf(distance) >= 1)
                    continue;
                const int weight = *cell & WEIGHT, gain = fabsf(distance) < nearer ? near_weight : 1;
                const int sum = weight + gain;
                const float mean = ((*cell >> BITS) * weight + distance * STEPS * gain) / sum;
                const int steps = (int)floorf(mean + 0.5f), least = steps < -STEPS ? -STEPS : steps;
                *cell = (least > STEPS ? STEPS : least) * (1 << BITS) + (sum < max_weight ? sum : max_weight);
            }
        }
    }
}

/* A scan of k points (x, then y) [cells] entered into the maps of n particles that own the tiles, from frames [n, 4]
   (cos, sin, x, y [cells]): each point and the next, where they are joined, on the fine level; on the coarse one with
   segments joined up to the chord. Lengths in fine cells, the coarse truncation in coarse ones. */
void integrate_all(int16_t *pool, const int *tables, int rows, int columns, const double *frames, int n,
                   const float *scan, const int *joined, int k, float truncation, float coarse_truncation, float chord,
                   float near, int near_weight, int max_weight)
{
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        const Map map = {pool, tables + (size_t)i * rows * columns, columns, rows};
        const float c = frames[4 * i], s = frames[4 * i + 1], x = frames[4 * i + 2], y = frames[4 * i + 3];
        int first = 0;
        float fx = c * scan[0] - s * scan[k] + x, fy = s * scan[0] + c * scan[k] + y, ax = fx, ay = fy;
        for (int j = 0; j + 1 < k; j++) {
            const float bx = c * scan[j + 1] - s * scan[k + j + 1] + x, by = s * scan[j + 1] + c * scan[k + j + 1] + y;
            if (joined[j]) {
                average(&map, pool, ax, ay, bx, by, truncation, near, near_weight, max_weight, 0);
                const float dx = scan[j + 1] - scan[first], dy = scan[k + j + 1] - scan[k + first];
                if (dx * dx + dy * dy >= chord * chord || !joined[j + 1] || j == k - 2) {
                    average(&map, pool, 0.5f * fx, 0.5f * fy, 0.5f * bx, 0.5f * by, coarse_truncation, 0.5f * near,
                            near_weight, max_weight, 1);
                    first = j + 1, fx = bx, fy = by;
                }
            } else {
                first = j + 1, fx = bx, fy = by;
            }
            ax = bx, ay = by;
        }
    }
}

/* What the coarse cells of the box [w, h] at (left, low) score: `near` minus their distance [steps], at least -near / 2,
   and nothing where they were never seen. */
static void scores_of(const Map *map, int left, int low, int w, int h, int near, int *box)
{
    for (int y = low; y < low + h; y++)
        for (int x = left; x < left + w;) {
            const int16_t *cell = map->pool + address(map, x, y, 1);
            const int tile_end = (x | (SIDE / 2 - 1)) + 1, end = tile_end < left + w ? tile_end : left + w;
            for (; x < end; x++, cell++) {
                const int score = near - abs(*cell >> BITS);
                *box++ = *cell & WEIGHT ? (score < -(near / 2) ? -(near / 2) : score) : 0;
            }
        }
}

/* The best of m shifts [m, 2] for each of a turns and n particles, by the scores of the coarse cells under k <= 64 points
   (x, then y), less the costs of turn and shift. Frames [n, 4] (cos, sin, x, y); lengths in coarse cells. The scores
   around a particle are laid out once, without tiles, since each is looked up several times. */
void search_all(const int16_t *pool, const int *tables, int rows, int columns, const double *frames, int n,
                const float *scan, int k, const float *turns, const int *turn_costs, int a, const float *shifts,
                const int *shift_costs, int m, int near, int *scores, int *chosen)
{
    float points = 0, moves = 0;
    for (int j = 0; j < k; j++)
        points = fmaxf(points, hypotf(scan[j], scan[k + j]));
    for (int v = 0; v < m; v++)
        moves = fmaxf(moves, hypotf(shifts[2 * v], shifts[2 * v + 1]));
    const float reach = points + moves + 1;
    const int side = 2 * (int)reach + 4;
#pragma omp parallel
    {
        int *box = malloc((size_t)side * side * sizeof *box);
#pragma omp for schedule(static)
        for (int i = 0; i < n; i++) {
            const Map map = {pool, tables + (size_t)i * rows * columns, columns, rows};
            const float c0 = frames[4 * i], s0 = frames[4 * i + 1], x0 = frames[4 * i + 2], y0 = frames[4 * i + 3];
            const int left = (int)fmaxf(x0 - reach, 0), right = (int)fminf(x0 + reach, columns * SIDE / 2 - 1);
            const int low = (int)fmaxf(y0 - reach, 0), high = (int)fminf(y0 + reach, rows * SIDE / 2 - 1);
            const int w = right - left + 1, h = high - low + 1;
            scores_of(&map, left, low, w, h, near, box);
            for (int t = 0; t < a; t++) {
                const float ct = cosf(turns[t]), st = sinf(turns[t]), c = c0 * ct - s0 * st, s = s0 * ct + c0 * st;
                float xs[64], ys[64];
                for (int j = 0; j < k; j++) {
                    xs[j] = c * scan[j] - s * scan[k + j] + x0 - left;
                    ys[j] = s * scan[j] + c * scan[k + j] + y0 - low;
                }
                int best = INT32_MIN, at = 0;
                for (int v = 0; v < m; v++) {
                    const float dx = c0 * shifts[2 * v] - s0 * shifts[2 * v + 1];
                    const float dy = s0 * shifts[2 * v] + c0 * shifts[2 * v + 1];
                    int total = -turn_costs[t] - shift_costs[v];
                    for (int j = 0; j < k; j++) {
                        const int ix = (int)fminf(fmaxf(xs[j] + dx, 0), w - 1);
                        const int iy = (int)fminf(fmaxf(ys[j] + dy, 0), h - 1);
                        total += box[iy * w + ix];
                    }
                    if (total > best)
                        best = total, at = v;
                }
                scores[i * a + t] = best, chosen[i * a + t] = at;
            }
        }
        free(box);
    }
}
