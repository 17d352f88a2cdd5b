/* The plain loops that the kernels are measured against: gcc -O3 -march=native -ffast-math -fopenmp.
   Arrays are C-contiguous; angles in rad, lengths in cells for scoring and in metres for rays. */
#include <math.h>

/* Scores of n poses [n, 3] (column, row, theta) on a float grid [h, w] with a border of zeros; points clamped. */
void score(const float *grid, int w, int h, const float *poses, int n, const float *px, const float *py, int k,
           float *out)
{
#pragma omp parallel for schedule(static)
    for (int i = 0; i < n; i++) {
        const float c = cosf(poses[3 * i + 2]), s = sinf(poses[3 * i + 2]);
        const float x = poses[3 * i], y = poses[3 * i + 1];
        float sum = 0.0f;
        for (int b = 0; b < k; b++) {
            int col = (int)(c * px[b] - s * py[b] + x);
            int row = (int)(s * px[b] + c * py[b] + y);
            col = col < 0 ? 0 : col > w - 1 ? w - 1 : col;
            row = row < 0 ? 0 : row > h - 1 ? h - 1 : row;
            sum += grid[row * w + col];
        }
        out[i] = sum;
    }
}

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
