/* Products of 16-bit rows with an input: half the memory of 32-bit ones, read once. Optional. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define EVERY_X86_64 __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EVERY_X86_64
#endif

enum {
    BLOCK = 4096,  /* inputs that stay in the first-level cache while rows go past */
    TOP = 32766,
    GROUP = 16
};

/* products[i] = sum over j of rows[i][j] * input[j]; sums of a block in float, of blocks in double */
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

/* The unit of a row that takes its largest value to TOP; 0 where there is nothing to hold. */
static double unit_of(const float *values, size_t n)
{
    uint32_t largest_bits = 0;  /* of numbers without their signs, in the order of the numbers */
    for (size_t j = 0; j < n; j++) {
        uint32_t bits;
        memcpy(&bits, values + j, sizeof bits);
        bits &= 0x7fffffff;
        largest_bits = bits > largest_bits ? bits : largest_bits;
    }
    float largest;
    memcpy(&largest, &largest_bits, sizeof largest);
    return largest > 0 && largest < 1e30f ? largest / TOP : 0;
}

static int nearest(float level)
{
    return (int)(level + (TOP + 1.5f)) - (TOP + 1);
}

static void quantise_row(const float *values, size_t n, int16_t *row, double *unit)
{
    *unit = unit_of(values, n);
    const float factor = *unit > 0 ? (float)(1 / *unit) : 0;
    for (size_t j = 0; j < n; j++)
        row[j] = (int16_t)nearest(values[j] * factor);
}

/*
 * The same for GROUP rows at once, and what rounding takes from one pixel is given to the next:
 * in the product with an image, whose neighbouring pixels are much alike, errors all but cancel.
 */
static void quantise_group(const float *values, size_t n, int16_t *rows, double *units)
{
    float factor[GROUP], rest[GROUP] = {0};
    for (size_t i = 0; i < GROUP; i++) {
        units[i] = unit_of(values + i * n, n);
        factor[i] = units[i] > 0 ? (float)(1 / units[i]) : 0;
    }
    for (size_t j = 0; j < n; j++)
        for (size_t i = 0; i < GROUP; i++) {  /* several rows, for each waits for its last pixel */
            const float level = values[i * n + j] * factor[i] + rest[i];
            const int rounded = nearest(level);
            rows[i * n + j] = (int16_t)rounded;
            rest[i] = level - (float)rounded;
        }
}

/* rows[i][j] = values[i][j] / units[i], rounded */
EVERY_X86_64
void quantise(const float *values, size_t n_rows, size_t n, int16_t *rows, double *units)
{
    for (size_t done = 0; done < n_rows;) {
        if (n_rows < GROUP) {
            quantise_row(values + done * n, n, rows + done * n, units + done);
            done++;
            continue;
        }
        const size_t i = done < n_rows - GROUP ? done : n_rows - GROUP;
        quantise_group(values + i * n, n, rows + i * n, units + i);
        done = i + GROUP;
    }
}
