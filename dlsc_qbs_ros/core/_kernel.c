/*
 * What an encoder does once a frame, compiled; optional. Each function does what the one of its
 * name in the modules beside it does with numpy, where it is described.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GLIBC__) && __GNUC__ >= 12 && !defined(__clang__)
#define EVERY_X86_64 __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_X86_64
#endif

enum {
    BLOCK = 4096,  /* inputs that stay in the first-level cache while rows go past */
    TOP = 32766
};

/* projection: products of short rows with an input; sums of a block in float, of blocks in double */
EVERY_X86_64
void project(const int16_t *rows, size_t n_rows, size_t n, const float *input, double *products)
{
    for (size_t i = 0; i < n_rows; i++)
        products[i] = 0.0;
    for (size_t start = 0; start < n; start += BLOCK) {
        const size_t width = n - start < BLOCK ? n - start : BLOCK;
        const float *x = input + start;
        size_t i = 0;
        for (; i + 4 <= n_rows; i += 4) {
            const int16_t *r0 = rows + i * n + start, *r1 = r0 + n, *r2 = r1 + n, *r3 = r2 + n;
            float s0 = 0, s1 = 0, s2 = 0, s3 = 0;
            for (size_t j = 0; j < width; j++) {
                s0 += r0[j] * x[j];
                s1 += r1[j] * x[j];
                s2 += r2[j] * x[j];
                s3 += r3[j] * x[j];
            }
            products[i] += s0;
            products[i + 1] += s1;
            products[i + 2] += s2;
            products[i + 3] += s3;
        }
        for (; i < n_rows; i++) {
            const int16_t *r = rows + i * n + start;
            float s = 0;
            for (size_t j = 0; j < width; j++)
                s += r[j] * x[j];
            products[i] += s;
        }
    }
}

/* projection: row[j] = values[j] / unit, rounded; returns the unit, that takes the largest to TOP */
EVERY_X86_64
double shorten(const float *values, size_t n, int16_t *row)
{
    uint32_t bits = 0;  /* of numbers without their signs, in the order of the numbers */
    for (size_t j = 0; j < n; j++) {
        uint32_t of_value;
        memcpy(&of_value, values + j, sizeof of_value);
        of_value &= 0x7fffffff;
        bits = of_value > bits ? of_value : bits;
    }
    float largest;
    memcpy(&largest, &bits, sizeof largest);
    if (!isfinite(largest)) {  /* nor are its products, then */
        memset(row, 0, n * sizeof *row);
        return NAN;
    }
    const float factor = largest > 1e-30f ? TOP / largest : 0;
    for (size_t j = 0; j < n; j++)
        row[j] = (int16_t)((int)(values[j] * factor + (TOP + 1.5f)) - (TOP + 1));
    return largest / TOP;
}

/* preprocessing: zero mean, the given deviation; sums of a view are exact in integers */
EVERY_X86_64
void standardise(const uint8_t *view, size_t n, double deviation, double min_contrast, float *input)
{
    uint64_t sum = 0, squares = 0;
    for (size_t start = 0; start < n; start += BLOCK) {
        const size_t stop = n - start < BLOCK ? n : start + BLOCK;
        uint32_t block_sum = 0, block_squares = 0;
        for (size_t j = start; j < stop; j++) {
            const uint32_t pixel = view[j];
            block_sum += pixel;
            block_squares += pixel * pixel;
        }
        sum += block_sum;
        squares += block_squares;
    }
    const double mean = (double)sum / n;
    const double variance = (double)squares / n - mean * mean;
    const double contrast = variance > min_contrast * min_contrast ? sqrt(variance) : min_contrast;
    const float factor = (float)(deviation / contrast), middle = (float)mean;
    for (size_t j = 0; j < n; j++)
        input[j] = ((float)view[j] - middle) * factor;
}

/* sparse_coding: y = a x for a symmetric matrix of m rows */
static inline void multiply(const double *a, size_t m, const double *x, double *y)
{
    for (size_t j = 0; j < m; j++)
        y[j] = 0;
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < m; j++)
            y[j] += a[i * m + j] * x[i];
}

/* sparse_coding: n_steps of the local coding iterations on one code, in place */
EVERY_X86_64
void proximal_steps(double *code, const double *b, const double *gram, size_t m, double eta_c,
                    double threshold, size_t n_steps, double *work)
{
    for (size_t step = 0; step < n_steps; step++) {
        multiply(gram, m, code, work);
        for (size_t j = 0; j < m; j++) {
            const double x = code[j] - eta_c * (work[j] - b[j]);
            const double taken = x > threshold ? threshold : x < -threshold ? -threshold : x;
            code[j] = x - taken;  /* not 0 where x is not finite */
        }
    }
}

/* In place, the solution of the k linear equations a x = b, a symmetric and positive definite. */
static int solve(double *a, size_t k, double *x)
{
    for (size_t i = 0; i < k; i++) {  /* a = l l^T, l in the lower half */
        for (size_t j = 0; j <= i; j++) {
            double sum = a[i * k + j];
            for (size_t p = 0; p < j; p++)
                sum -= a[i * k + p] * a[j * k + p];
            if (i == j && !(sum > 0))
                return 0;
            a[i * k + j] = i == j ? sqrt(sum) : sum / a[j * k + j];
        }
    }
    for (size_t i = 0; i < k; i++) {
        for (size_t p = 0; p < i; p++)
            x[i] -= a[i * k + p] * x[p];
        x[i] /= a[i * k + i];
    }
    for (size_t i = k; i-- > 0;) {
        for (size_t p = i + 1; p < k; p++)
            x[i] -= a[p * k + i] * x[p];
        x[i] /= a[i * k + i];
    }
    return 1;
}

static inline double sign_above(double x, double threshold)
{
    return x > threshold ? 1 : x < -threshold ? -1 : 0;
}

/* sparse_coding: the exact code by active sets; returns whether it was found */
EVERY_X86_64
int active_set(const double *inverse, const double *b, size_t m, double lambda_1, double weight,
               size_t max_sets, double *code, double *work)
{
    double *signs = work, *right = work + m, *q = work + 2 * m, *equations = work + 3 * m;
    multiply(inverse, m, b, code);
    for (size_t j = 0; j < m; j++)
        signs[j] = sign_above(code[j], 0);
    for (size_t set = 0; set < max_sets; set++) {
        size_t n_zero = 0;
        for (size_t j = 0; j < m; j++)
            right[j] = b[j] - lambda_1 * signs[j];
        multiply(inverse, m, right, code);
        for (size_t j = 0; j < m; j++)
            if (signs[j] == 0)
                q[n_zero++] = code[j];
        for (size_t i = 0, row = 0; i < m; i++)
            if (signs[i] == 0) {
                for (size_t j = 0, column = 0; j < m; j++)
                    if (signs[j] == 0)
                        equations[row * n_zero + column++] = inverse[i * m + j];
                row++;
            }
        if (!solve(equations, n_zero, q))
            return 0;
        for (size_t i = 0, row = 0; i < m; i++)
            if (signs[i] == 0) {
                for (size_t j = 0; j < m; j++)
                    code[j] -= inverse[i * m + j] * q[row];
                row++;
            }
        int is_confirmed = 1;
        for (size_t j = 0, row = 0; j < m; j++) {
            const int is_zero = signs[j] == 0;
            const double multiplier = is_zero ? q[row++] : lambda_1 * signs[j];
            code[j] = is_zero ? 0 : code[j];
            const double found = sign_above(multiplier + weight * code[j], lambda_1);
            is_confirmed &= found == signs[j];
            signs[j] = found;
        }
        if (is_confirmed)
            return 1;
    }
    return 0;
}

/* snapshot: matrix -= x^T y for x of n rows of m and y of n rows of k */
EVERY_X86_64
void subtract_product(double *matrix, size_t stride, size_t n, size_t m, size_t k, const double *x,
                      const double *y)
{
    for (size_t p = 0; p < n; p++)
        for (size_t i = 0; i < m; i++)
            for (size_t j = 0; j < k; j++)
                matrix[i * stride + j] -= x[p * m + i] * y[p * k + j];
}
