/* The plain loops that the kernels are measured against: gcc -O3 -march=native -ffast-math -fopenmp.
   Arrays are C-contiguous; angles in rad, lengths in metres. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

/* Ranges of n rays (x, y, angle) against m segments [m, 4], every one tried. */
void cast_all(const float *segments, int m, const float *rays, int n, float max_range, float *out)
{
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        const float x = rays[3 * i], y = rays[3 * i + 1];
        const float dx = cosf(rays[3 * i + 2]), dy = sinf(rays[3 * i + 2]);
        float best = max_range;
        for (int j = 0; j < m; j++) {
            const float *q = segments + 4 * j;
            const float ex = q[2] - q[0], ey = q[3] - q[1], wx = q[0] - x, wy = q[1] - y;
            const float inverse = 1.0f / (dx * ey - dy * ex);
            const float t = (wx * ey - wy * ex) * inverse, u = (wx * dy - wy * dx) * inverse;
            best = (t >= 0.0f && u >= 0.0f && u <= 1.0f && t < best) ? t : best;
        }
        out[i] = best;
    }
}

/* One scan entered into a grid of log-odds [.., w]: along the Bresenham ray to each of n ends (column, row) -miss, at
   its end +hit, saturating. One thread, as the kernel. */
void update(int16_t *grid, int w, int col, int row, const int *ends, int n, int hit, int miss, int limit)
{
    for (int b = 0; b < n; b++) {
        int across = ends[2 * b] - col, up = ends[2 * b + 1] - row;
        const int right = across < 0 ? -1 : 1, upward = up < 0 ? -w : w;
        across = abs(across), up = abs(up);
        const int wide = across >= up, major = wide ? across : up, minor = wide ? up : across;
        int cell = row * w + col, error = major / 2;
        for (int i = 0; i < major; i++) {
            const int value = grid[cell] - miss;
            grid[cell] = value < -limit ? -limit : value;
            error -= minor;
            cell += wide ? right : upward;
            if (error < 0) {
                cell += wide ? upward : right;
                error += major;
            }
        }
        const int value = grid[cell] + hit;
        grid[cell] = value > limit ? limit : value;
    }
}

/* Maps of tiles as of kernels/tiles.py: 32 x 32 fine cells of int16 and behind them 16 x 16 coarse ones; in a cell the
   distance in 1/1023 truncations, and in the lowest 5 bits its weight. */
enum { BITS = 5, SIDE = 1 << BITS, TILE = SIDE * SIDE * 5 / 4, STEPS = 1023, WEIGHT = 31 };

typedef struct {
    const int16_t *pool;
    const int *table;
    int columns, rows;
} Map;

static inline int cell_at(const Map *map, int x, int y, int level)
{
    const int shift = BITS - level, mask = (SIDE >> level) - 1;
    const int tile = map->table[(y >> shift) * map->columns + (x >> shift)];
    return map->pool[tile * TILE + level * SIDE * SIDE + ((y & mask) << shift) + (x & mask)];
}

/* Distance [truncations], its derivatives by a cell and whether it is known, between the four cells around a place. */
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
    d[0] = (low + fy * (high - low)) / STEPS;
    d[1] = ((db - da) * (1 - fy) + (de - dc) * fy) / STEPS;
    d[2] = (high - low) / STEPS;
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

/* What Gauss-Newton has of an endpoint (rx, ry) in the robot's frame: residual and derivatives by (x, y, theta). */
static inline void add(float *h, const float *f, const float *d, float scale, float slope, float rx, float ry)
{
    const float wx = d[1] * slope, wy = d[2] * slope;
    const float jx = f[0] * wx + f[1] * wy, jy = -f[1] * wx + f[0] * wy, jt = jy * rx - jx * ry, r = d[0] * scale;
    h[0] += jx * jx, h[1] += jx * jy, h[2] += jx * jt, h[3] += jy * jy, h[4] += jy * jt, h[5] += jt * jt;
    h[6] -= jx * r, h[7] -= jy * r, h[8] -= jt * r;
}

/* A scan of k points (x, then y) registered to the maps of n particles, from frames [n, 4] (cos, sin, x, y [m]) and a
   prior of these inverse variances: Gauss-Newton on the coarse level, then on the fine one, then the fit there: cost,
   likelihood, and rays that cross a surface. Writes offset, information, these three, and how many times the scan was
   gone through: [n, 13]. */
void register_all(const int16_t *pool, const int *tables, int rows, int columns, const double *frames, int n,
                  const float *scan, int k, const float *prior, float cell, float truncation, float coarse_truncation,
                  float sd, int iterations, double *out)
{
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        const Map map = {pool, tables + (size_t)i * rows * columns, columns, rows};
        const float f[4] = {frames[4 * i], frames[4 * i + 1], frames[4 * i + 2], frames[4 * i + 3]};
        float o[3] = {0}, d[3], h[9];
        int passes = 1;
        for (int level = 1; level >= 0; level--) {
            const float inverse = 1 / (cell * (1 << level)), wide = level ? 10.0f : 1.0f;
            const float scale = level ? coarse_truncation / (2 * sd) : truncation / sd, slope = scale * inverse;
            for (int step = 0; step < iterations; step++) {
                const float c = cosf(o[2]), s = sinf(o[2]);
                float x[3];
                passes++;
                for (int j = 0; j < 9; j++)
                    h[j] = 0;
                h[0] = prior[0], h[3] = prior[1], h[5] = prior[2];
                for (int j = 0; j < 3; j++)
                    h[6 + j] = -prior[j] * o[j];
                for (int j = 0; j < k; j++) {
                    const float rx = c * scan[j] - s * scan[k + j], ry = s * scan[j] + c * scan[k + j];
                    const float px = rx + o[0], py = ry + o[1];
                    const float gx = (f[0] * px - f[1] * py + f[2]) * inverse;
                    const float gy = (f[1] * px + f[0] * py + f[3]) * inverse;
                    if (between(&map, gx, gy, level, d))
                        add(h, f, d, scale, slope, rx, ry);
                }
                cholesky(h, h + 6, x);
                for (int j = 0; j < 3; j++)
                    o[j] += x[j];
                if (fabsf(x[0]) + fabsf(x[1]) < wide * 3e-4f && fabsf(x[2]) < wide * 1e-4f)
                    break;
            }
        }
        const float c = cosf(o[2]), s = sinf(o[2]), inverse = 1 / cell, scale = truncation / sd;
        const float ox = f[0] * o[0] - f[1] * o[1] + f[2], oy = f[1] * o[0] + f[0] * o[1] + f[3];
        float cost = 0, likely = 0, crossed = 0;
        for (int j = 0; j < 9; j++)
            h[j] = 0;
        for (int j = 0; j < k; j++) {
            const float rx = c * scan[j] - s * scan[k + j], ry = s * scan[j] + c * scan[k + j];
            const float qx = rx + o[0], qy = ry + o[1];
            const float px = f[0] * qx - f[1] * qy + f[2], py = f[1] * qx + f[0] * qy + f[3];
            float r = 0;
            int seen = between(&map, px * inverse, py * inverse, 0, d);
            if (seen) {
                r = d[0] * scale;
                add(h, f, d, scale, scale * inverse, rx, ry);
            } else {
                seen = between(&map, 0.5f * px * inverse, 0.5f * py * inverse, 1, d);
                r = d[0] * coarse_truncation / sd;
            }
            cost += seen ? fminf(0.5f * r * r, 8.0f) : 2.0f;
            likely += seen ? expf(-0.125f * r * r) : 0;
            const float length = sqrtf((px - ox) * (px - ox) + (py - oy) * (py - oy));
            int hit = 0;
            for (int m = 0; m < 6; m++) {
                const float share = 0.9f - 0.15f * m;
                if ((1 - share) * length > 2 * truncation) {
                    const int gx = (int)((ox + share * (px - ox)) * inverse);
                    const int gy = (int)((oy + share * (py - oy)) * inverse);
                    const int word = cell_at(&map, gx, gy, 0);
                    hit |= (word & WEIGHT) > 4 && abs(word >> 5) < STEPS / 3;
                }
            }
            crossed += hit;
        }
        for (int j = 0; j < 3; j++)
            out[13 * i + j] = o[j];
        for (int j = 0; j < 6; j++)
            out[13 * i + 3 + j] = h[j];
        out[13 * i + 9] = cost, out[13 * i + 10] = likely, out[13 * i + 11] = crossed;
        out[13 * i + 12] = passes;
    }
}

/* One scan of n endpoints (x, y) from the origin, thinned as by kernels/thinning.py: groups within a spacing become their
   mean, in passes of growing spacing while there are more than `most`. Returns how many points (x, y) there are. */
int thin(const float *ends, int n, float gap, float gap_from_range, float spacing, float max_spacing, int most,
         float *points, int *joined)
{
    for (float within = spacing;;) {
        int out = 0;
        for (int first = 0; first < n && (out <= most || within >= max_spacing); out++) {
            const float x0 = ends[2 * first], y0 = ends[2 * first + 1];
            float x = x0, y = y0, sum_x = x0, sum_y = y0, far = sqrtf(x0 * x0 + y0 * y0);
            int k = first + 1, same = 0;
            for (; k < n; k++) {
                const float px = ends[2 * k], py = ends[2 * k + 1], range = sqrtf(px * px + py * py);
                if (sqrtf((px - x) * (px - x) + (py - y) * (py - y)) > gap + gap_from_range * fmaxf(far, range))
                    break;
                if (sqrtf((px - x0) * (px - x0) + (py - y0) * (py - y0)) >= within) {
                    same = 1;
                    break;
                }
                sum_x += px, sum_y += py, x = px, y = py, far = range;
            }
            points[2 * out] = sum_x / (k - first), points[2 * out + 1] = sum_y / (k - first), joined[out] = same;
            first = k;
        }
        if (out <= most || within >= max_spacing)
            return out;
        within = fminf(fmaxf(within * 1.2f, 0.001f), max_spacing);
    }
}

/* The sum of n floats: what memory gives. */
float sum(const float *values, long n)
{
    float total = 0;
#pragma omp parallel for schedule(static) reduction(+ : total)
    for (long i = 0; i < n; i++)
        total += values[i];
    return total;
}

/* Arithmetic alone, n chains of k steps, no memory: what this number of threads can gain on this machine. */
void arithmetic(int n, int k, float *out)
{
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        float a = (float)i, b = 0.5f;
        for (int j = 0; j < k; j++) {
            a = a * 0.999f + b;
            b = b * 0.998f + 0.1f;
        }
        out[i] = a + b;
    }
}
