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
