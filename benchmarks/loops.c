/* The plain loops that the kernels are measured against, but for those over maps of tiles (maps.c).
   Arrays are C-contiguous; angles in rad, lengths in metres where nothing else is said. */
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

/* Of each of n poses the best of its headings and of span x span shifts, the first of equal ones in the given order, by
   the sum of the cells [h, w] under k <= 4096 points (x, then y). Frames [n, headings, 4] (cos, sin, column, row); lengths
   in cells, at most 512 places. */
void match_all(const uint8_t *grid, int w, int h, const float *frames, int n, int headings, const float *scan, int k,
               const int *shifts, int span, const int *order, int *scores, int *best)
{
    const float low = -shifts[0], last_x = w - 1 - shifts[span - 1], last_y = h - 1 - shifts[span - 1];
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        int cells[4096], sums[512], top = -1, at = 0;
        for (int t = 0; t < headings; t++) {
            const float *f = frames + 4 * (i * headings + t);
            for (int j = 0; j < k; j++) {
                const int x = (int)fminf(fmaxf(f[0] * scan[j] - f[1] * scan[k + j] + f[2], low), last_x);
                const int y = (int)fminf(fmaxf(f[1] * scan[j] + f[0] * scan[k + j] + f[3], low), last_y);
                cells[j] = y * w + x;
            }
            for (int a = 0; a < span; a++)
                for (int b = 0; b < span; b++) {
                    const uint8_t *moved = grid + shifts[b] * w + shifts[a];
                    int sum = 0;
                    for (int j = 0; j < k; j++)
                        sum += moved[cells[j]];
                    sums[(a * span + b) * headings + t] = sum;
                }
        }
        for (int v = 0; v < span * span * headings; v++)
            if (sums[order[v]] > top)
                top = sums[order[v]], at = order[v];
        scores[i] = top, best[i] = at;
    }
}

/* One scan of n endpoints (x, y) from the origin, thinned as by kernels/scans.py: groups within a spacing become their
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
