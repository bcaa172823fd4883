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

/* Functions of the C library, lane by lane: CasADi's interpreter has the same digits. */
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

static inline void sine_cosine(vec angle, vec *sine, vec *cosine)
{
    EACH_LANE {
        (*sine)[lane] = sin(angle[lane]);
        (*cosine)[lane] = cos(angle[lane]);
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
