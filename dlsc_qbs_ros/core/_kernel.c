/*
 * What an encoder does once a frame, compiled; optional. The comments name the modules beside it
 * where functions are described; those of `planes` have no other form, the rest does what is done
 * there with numpy.
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

/* Of this file, by setup.py: `kernel` takes no library that was made of another version of it. */
const uint32_t source_crc = SOURCE_CRC;

enum {
    BLOCK = 2048,  /* columns of a block; entries of a row of it share a unit */
    GROUP = 256,  /* products of 16 and 8 bits whose sum fits into 32 */
    ROWS = 4,  /* rows that are multiplied in turns: memory gives several streams faster */
    ENTRY_MAX = 0x7fffff
};

/* Have memory brought to the second-level cache that is needed soon; any address will do. */
static inline void fetch(const void *start, size_t size)
{
    for (size_t offset = 0; offset < size; offset += 64)
        __builtin_prefetch((const char *)start + offset, 0, 2);
}

/*
 * planes: a matrix in three bytes an entry, block by block of columns. An entry is
 * (256 high + low) unit, its unit a power of two for each row of a block, so it is a float to the
 * last bit. Rows of a block are BLOCK entries, of which `width` are in use; others are zeros.
 */

/* planes: write a block of rows of floats, with the unit of each and the sum of its entries */
EVERY_X86_64
void split(const float *values, size_t n_rows, size_t width, int16_t *high, uint8_t *low,
           double *units, double *sums)
{
    for (; n_rows-- > 0; values += width, high += BLOCK, low += BLOCK) {
        fetch(high + BLOCK, width * sizeof *high);
        fetch(low + BLOCK, width);
        uint32_t bits = 0;  /* of numbers without their signs, in the order of the numbers */
        for (size_t j = 0; j < width; j++) {
            uint32_t of_value;
            memcpy(&of_value, values + j, sizeof of_value);
            of_value &= 0x7fffffff;
            bits = of_value > bits ? of_value : bits;
        }
        float largest;
        memcpy(&largest, &bits, sizeof largest);
        const int exponent = isfinite(largest) ? ilogbf(largest > 1e-30f ? largest : 1e-30f) : 0;
        const float factor = isfinite(largest) ? ldexpf(1, 22 - exponent) : 0;
        int64_t sum = 0;
        for (size_t j = 0; j < width; j++) {
            const float x = factor > 0 ? values[j] * factor : 0;
            int32_t entry = (int32_t)(x + copysignf(0.5f, x));
            entry = entry < ENTRY_MAX ? entry : ENTRY_MAX;
            high[j] = (int16_t)(entry >> 8);
            low[j] = (uint8_t)entry;
            sum += entry;
        }
        *units++ = isfinite(largest) ? ldexp(1, exponent - 22) : NAN;
        *sums++ = (double)sum;
    }
}

/* planes: read a block of rows */
EVERY_X86_64
void join(const int16_t *high, const uint8_t *low, const double *units, size_t n_rows,
          size_t width, float *values, size_t values_stride)
{
    for (; n_rows-- > 0; values += values_stride, high += BLOCK, low += BLOCK) {
        const float unit = (float)*units++;
        fetch(high + BLOCK, width * sizeof *high);
        fetch(low + BLOCK, width);
        for (size_t j = 0; j < width; j++)
            values[j] = (float)(high[j] * 256 + low[j]) * unit;
    }
}

/* planes: pixels without their mean, of a block of rows with factor, mean and sum */
EVERY_X86_64
void centre(const uint8_t *pixels, const double *affine, size_t n_rows, size_t width,
            float *values, size_t values_stride)
{
    for (; n_rows-- > 0; values += values_stride, pixels += BLOCK, affine += 3) {
        const float mean = (float)affine[1];
        fetch(pixels + BLOCK, width);
        for (size_t j = 0; j < width; j++)
            values[j] = (float)pixels[j] - mean;
    }
}

/* planes: add products of ROWS rows of a block, or less, and pixels; exact within the block */
static inline void multiply_planes(const int16_t *high, const uint8_t *low, const double *units,
                                   size_t n_rows, const int16_t *pixels, double *products)
{
    int64_t sums[ROWS] = {0};
    for (size_t from = 0; from < BLOCK; from += GROUP)
        for (size_t i = 0; i < n_rows; i++) {
            const int16_t *const h = high + i * BLOCK + from;
            const uint8_t *const l = low + i * BLOCK + from;
            int32_t of_high = 0, of_low = 0;
            fetch(h + ROWS * BLOCK, GROUP * sizeof *h);
            fetch(l + ROWS * BLOCK, GROUP);
            for (size_t j = 0; j < GROUP; j++)
                of_high += h[j] * pixels[from + j];
            for (size_t j = 0; j < GROUP; j++)
                of_low += (int16_t)l[j] * pixels[from + j];
            sums[i] += (int64_t)of_high * 256 + of_low;
        }
    for (size_t i = 0; i < n_rows; i++)
        products[i] += units[i] * (double)sums[i];
}

/* pixels: the product of two rows of a block, exact */
static inline double multiply_pixels(const uint8_t *row, const int16_t *pixels)
{
    int32_t product = 0;
    fetch(row + BLOCK, BLOCK);
    for (size_t j = 0; j < BLOCK; j++)
        product += (int16_t)row[j] * pixels[j];
    return (double)product;
}

/*
 * planes: products of an input with the atoms and with kept inputs, all of these affine in pixels:
 * factor (pixel - mean). `kept` has `room` rows, of which n_kept are in use; `kept_affine` holds
 * factor, mean and sum of the pixels of each.
 */
EVERY_X86_64
void project(const int16_t *high, const uint8_t *low, const double *units, const double *sums,
             const uint8_t *kept, const double *kept_affine, size_t n_atoms, size_t room,
             size_t n_kept, const uint8_t *pixels, size_t n, double factor, double mean, double sum,
             double *products)
{
    for (size_t i = 0; i < n_atoms + n_kept; i++)
        products[i] = 0;
    for (size_t start = 0; start < n; start += BLOCK, kept += room * BLOCK) {
        const size_t width = n - start < BLOCK ? n - start : BLOCK;
        int16_t block[BLOCK] = {0};
        for (size_t j = 0; j < width; j++)
            block[j] = pixels[start + j];
        for (size_t i = 0, n_rows; i < n_atoms; i += n_rows) {
            n_rows = n_atoms - i < ROWS ? n_atoms - i : ROWS;
            multiply_planes(high, low, units, n_rows, block, products + i);
            high += n_rows * BLOCK, low += n_rows * BLOCK, units += n_rows;
        }
        for (size_t k = 0; k < n_kept; k++)
            products[n_atoms + k] += multiply_pixels(kept + k * BLOCK, block);
    }
    for (size_t i = 0; i < n_atoms; i++, products++)
        *products = factor * (*products - mean * sums[i]);
    for (size_t k = 0; k < n_kept; k++, products++, kept_affine += 3)
        *products = factor * kept_affine[0] * (
            *products - mean * kept_affine[2] - kept_affine[1] * sum
            + mean * kept_affine[1] * n);
}

/* preprocessing: the sum of pixels and that of their squares */
EVERY_X86_64
void sum_pixels(const uint8_t *pixels, size_t n, double *sums)
{
    sums[0] = sums[1] = 0;
    for (size_t start = 0; start < n; start += BLOCK) {
        const size_t stop = n - start < BLOCK ? n : start + BLOCK;
        uint32_t sum = 0, squares = 0;
        for (size_t j = start; j < stop; j++) {
            const uint32_t pixel = pixels[j];
            sum += pixel;
            squares += pixel * pixel;
        }
        sums[0] += sum;
        sums[1] += squares;
    }
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

/*
 * sparse_coding: a code, in place, the products of the input with the atoms and the gradient, from
 * the products with n_rows rows, of which the atoms are a mix; returns code (gradient - b)
 */
EVERY_X86_64
double infer(const double *products, size_t n_rows, const double *mix, size_t mix_stride,
             const double *gram, size_t m, double eta_c, double threshold, size_t n_steps,
             double *code, double *b, double *gradient)
{
    for (size_t i = 0; i < m; i++) {
        double product = 0;
        for (size_t j = 0; j < n_rows; j++)
            product += mix[i * mix_stride + j] * products[j];
        b[i] = product;
    }
    for (size_t step = 0; step <= n_steps; step++) {
        for (size_t j = 0; j < m && step > 0; j++) {
            const double x = code[j] - eta_c * gradient[j];
            const double taken = x > threshold ? threshold : x < -threshold ? -threshold : x;
            code[j] = x - taken;  /* not 0 where x is not finite */
        }
        multiply(gram, m, code, gradient);
        for (size_t j = 0; j < m; j++)
            gradient[j] -= b[j];
    }
    double sum = 0;
    for (size_t j = 0; j < m; j++)
        sum += code[j] * (gradient[j] - b[j]);
    return sum;
}

/* sparse_coding: iterations from zero on many codes of few entries, whose places are `used` */
EVERY_X86_64
void sparse_codes(const float *b, size_t n, const float *gram, size_t m, float eta_c,
                  float threshold, size_t n_steps, float *code, float *descent, uint16_t *used)
{
    for (; n-- > 0; b += m, code += m) {
        size_t n_used = 0;
        memset(code, 0, m * sizeof *code);
        for (size_t step = 0; step == 0 || (step < n_steps && n_used > 0); step++) {
            memcpy(descent, b, m * sizeof *b);
            for (size_t u = 0; u < n_used; u++)
                for (size_t j = 0; j < m; j++)
                    descent[j] -= gram[used[u] * m + j] * code[used[u]];
            for (size_t j = 0; j < m; j++) {
                const float x = code[j] + eta_c * descent[j];
                const float taken = x > threshold ? threshold : x < -threshold ? -threshold : x;
                code[j] = x - taken;
            }
            n_used = 0;
            for (size_t j = 0; j < m; j++) {
                used[n_used] = (uint16_t)j;
                n_used += code[j] != 0;
            }
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

/*
 * sparse_coding: the exact code by active sets, the first entries of `work`, which is of
 * m (m + 4); returns whether it was found
 */
EVERY_X86_64
int active_set(const double *inverse, const double *b, size_t m, double lambda_1, double weight,
               size_t max_sets, double *work)
{
    double *code = work, *signs = work + m, *right = work + 2 * m, *q = work + 3 * m;
    double *equations = work + 4 * m;
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
