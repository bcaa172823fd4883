/* Numbers of several poses side by side, one a lane of the processor's vectors.

   The vectors are an extension of GCC and Clang, which know them on every processor.
   Comparisons give masks, with all bits of a lane set or none. */

#include <math.h>
#include <stdint.h>

#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t mask __attribute__((vector_size(8 * LANES)));

#define EACH_LANE for (int lane = 0; lane < LANES; lane++)

static inline vec splat(double number)
{
    vec all;
    EACH_LANE all[lane] = number;
    return all;
}

static inline int any(mask condition)
{
    int64_t bits = 0;
    EACH_LANE bits |= condition[lane];
    return bits != 0;
}

/* x where the condition holds, 0 elsewhere, also for infinite x and NaN */
static inline vec keep(mask condition, vec x)
{
    return (vec)((mask)x & condition);
}

static inline vec choose(mask condition, vec x, vec otherwise)
{
    return (vec)(((mask)x & condition) | ((mask)otherwise & ~condition));
}

/* 1 where the condition holds, 0 elsewhere: CasADi's truth values */
static inline vec truth(mask condition)
{
    return keep(condition, splat(1.0));
}

static inline vec absolute(vec x)
{
    return (vec)((mask)x & INT64_MAX);
}

static inline vec square_root(vec x)
{
    vec root;
    EACH_LANE root[lane] = sqrt(x[lane]);
    return root;
}

/* Functions of the C library, lane by lane: rare in the equations of machines. */
#define LANE_BY_LANE(name, function)                                                   \
    static vec name(vec x)                                                             \
    {                                                                                  \
        vec value;                                                                     \
        EACH_LANE value[lane] = function(x[lane]);                                     \
        return value;                                                                  \
    }
#define PAIR_BY_PAIR(name, function)                                                   \
    static vec name(vec x, vec y)                                                      \
    {                                                                                  \
        vec value;                                                                     \
        EACH_LANE value[lane] = function(x[lane], y[lane]);                            \
        return value;                                                                  \
    }

static inline double sign_of(double x)
{
    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;
}

LANE_BY_LANE(exponential, exp)
LANE_BY_LANE(logarithm, log)
LANE_BY_LANE(tangent, tan)
LANE_BY_LANE(arcsine, asin)
LANE_BY_LANE(arccosine, acos)
LANE_BY_LANE(arctangent, atan)
LANE_BY_LANE(hyperbolic_sine, sinh)
LANE_BY_LANE(hyperbolic_cosine, cosh)
LANE_BY_LANE(hyperbolic_tangent, tanh)
LANE_BY_LANE(sign, sign_of)
LANE_BY_LANE(round_down, floor)
LANE_BY_LANE(round_up, ceil)
PAIR_BY_PAIR(power, pow)
PAIR_BY_PAIR(direction, atan2)
PAIR_BY_PAIR(hypotenuse, hypot)
PAIR_BY_PAIR(with_sign, copysign)
PAIR_BY_PAIR(smaller, fmin)
PAIR_BY_PAIR(larger, fmax)
PAIR_BY_PAIR(remainder_of, fmod)

/* Sine and cosine, to about an ulp.

   The angle is reduced to a quarter turn about 0 with pi/2 in three parts (Cody and
   Waite), of which the first two have 33 bits: their products with a number of quarter
   turns below 2^20 are exact. The polynomials are those of fdlibm (Sun Microsystems
   1993, k_sin.c and k_cos.c). Beyond, the C library takes over. */
#define FARTHEST_ANGLE 1e5

static inline void sine_cosine(vec angle, vec *sine, vec *cosine)
{
    const vec shift = splat(0x1.8p52);
    vec shifted = angle * splat(6.36619772367581382433e-01) + shift;
    vec turns = shifted - shift;
    mask quarter = (mask)shifted;
    vec x = angle - turns * splat(1.57079632673412561417e+00);
    x = x - turns * splat(6.07710050630396597660e-11);
    x = x - turns * splat(2.02226624879595063154e-21);
    vec z = x * x;

    vec s = splat(1.58969099521155010221e-10);
    s = s * z + splat(-2.50507602534068634195e-08);
    s = s * z + splat(2.75573137070700676789e-06);
    s = s * z + splat(-1.98412698298579493134e-04);
    s = s * z + splat(8.33333333332248946124e-03);
    s = s * z + splat(-1.66666666666666324348e-01);
    s = x + (x * z) * s;

    vec c = splat(-1.13596475577881948265e-11);
    c = c * z + splat(2.08757232129817482790e-09);
    c = c * z + splat(-2.75573143513906633035e-07);
    c = c * z + splat(2.48015872894767294178e-05);
    c = c * z + splat(-1.38888888888741095749e-03);
    c = c * z + splat(4.16666666666666019037e-02);
    vec half = splat(0.5) * z;
    vec most = splat(1.0) - half;
    c = most + (((splat(1.0) - most) - half) + (z * z) * c);

    mask odd = -(quarter & 1);
    vec a = choose(odd, c, s);
    vec b = choose(odd, s, c);
    *sine = (vec)((mask)a ^ ((quarter & 2) << 62));
    *cosine = (vec)((mask)b ^ (((quarter + 1) & 2) << 62));

    mask far = ~(absolute(angle) <= splat(FARTHEST_ANGLE));
    if (any(far)) {
        EACH_LANE if (far[lane])
        {
            (*sine)[lane] = sin(angle[lane]);
            (*cosine)[lane] = cos(angle[lane]);
        }
    }
}

/* Inputs of poses: a pose of number i is row (i / inner, i % inner) of each input.

   place   first number of an input
   outer   numbers from one row to the next over i / inner; 0 where all have the same
   step    the same over i % inner */
typedef struct {
    const double *place;
    int64_t outer, step, entries;
} input;

/* Poses `first` and on as lanes; lanes beyond the last pose repeat it. */
static void load(
    const input *inputs, int count, int64_t inner, int64_t first, int64_t end, vec *into)
{
    EACH_LANE
    {
        int64_t pose = first + lane < end ? first + lane : end - 1;
        int64_t row = pose / inner, column = pose % inner;
        double *entry = (double *)into + lane;
        for (int k = 0; k < count; k++) {
            const double *place
                = inputs[k].place + row * inputs[k].outer + column * inputs[k].step;
            for (int64_t i = 0; i < inputs[k].entries; i++, entry += LANES)
                *entry = place[i];
        }
    }
}

/* Lanes to rows of `entries` numbers; those beyond the last pose are dropped. */
static void store(const vec *from, int64_t entries, int64_t first, int64_t end, double *rows)
{
    for (int lane = 0; lane < LANES && first + lane < end; lane++) {
        const double *entry = (const double *)from + lane;
        double *row = rows + (first + lane) * entries;
        for (int64_t i = 0; i < entries; i++)
            row[i] = entry[i * LANES];
    }
}
