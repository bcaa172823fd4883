/* Newton's method for ROWS equations in each lane.

   Outputs of the function: values (ROWS,) and slopes (ROWS, ROWS) over the unknowns,
   which come first among the inputs.

   Once the last steps of all lanes are short, further steps keep their slopes (the chord
   method; Ortega and Rheinboldt 1970, section 7.1): each leaves the same share of the
   error, so that two steps s1 and s2 show the error that remains, s2^2 / s1. */

typedef struct {
    double step_tolerance; /* longest last step */
    double longest;        /* longest step of a lane that this method may solve */
    double short_step;     /* step after which the slopes are kept */
    double remaining;      /* error that a lane's last step may leave */
    double acceptable;     /* the same where rounding permits no less */
    double newton_steps, chord_steps; /* most steps of each kind */
} limits;

/* A step; the largest entry of each lane's, NaN where one is. */
static vec step_from(const factors *f, const vec *out, vec *step)
{
    for (int i = 0; i < ROWS; i++)
        step[i] = out[i];
    substitute(f, step);
    vec size = splat(0.0);
    for (int i = 0; i < ROWS; i++) {
        vec length = absolute(step[i]);
        size = choose((length <= size) | (size != size), size, length);
    }
    return size;
}

static void take(mask moves, const vec *step, vec *in)
{
    for (int i = 0; i < ROWS; i++)
        in[i] -= keep(moves, step[i]);
}

/* Solve in all lanes; which are solved, and which others ended with a short step. */
static void solve_lanes(
    vec *in, const double *constants, const limits *at, mask *solved, mask *near)
{
    vec fixed[FIXED_ENTRIES + 1], out[OUTPUT_ENTRIES + 1];
    mask moves = ~(mask){0};
    factors f;
    vec before, step[ROWS];
    prepare(in, constants, fixed, out);
    /* A lane whose step is short stays while others move: it finds the same step again. */
    for (int64_t k = 1;; k++) {
        every_output(in, constants, fixed, out);
        factorise(out + ROWS, 0, &f);
        before = step_from(&f, out, step);
        moves &= before <= splat(at->longest); /* not where it is NaN */
        mask goes_on = moves & (before > splat(at->short_step));
        if (k == at->newton_steps || !any(goes_on))
            break;
        take(goes_on, step, in);
    }
    take(moves, step, in);
    mask possible = moves;
    vec after = before, error = splat(INFINITY);
    for (int64_t k = 0; k < at->chord_steps && any(moves); k++) {
        first_output(in, constants, fixed, out);
        after = step_from(&f, out, step);
        take(moves, step, in);
        vec remains = choose(moves, after * after / before, error);
        error = choose(after == splat(0.0), splat(0.0), remains);
        moves &= ~(after <= splat(at->step_tolerance)) | ~(error <= splat(at->remaining));
        before = after;
    }
    mask is_short = ~moves | (after <= splat(at->step_tolerance));
    *solved = possible & is_short & (error <= splat(at->acceptable));
    *near = possible & is_short & ~*solved;
}

/* Poses `first` to `end`: solutions (n, ROWS), and states (n,): 1 solved, 2 near, 0 */
void pkm_newton(
    int64_t first, int64_t end, int64_t inner, const input *inputs,
    const double *constants, const limits *at, double *solutions, uint8_t *states)
{
    vec in[INPUT_ENTRIES + 1];
    for (int64_t pose = first; pose < end; pose += LANES) {
        mask solved, near;
        load(inputs, INPUTS, inner, pose, end, in);
        solve_lanes(in, constants, at, &solved, &near);
        store(in, ROWS, pose, end, solutions);
        for (int lane = 0; lane < LANES && pose + lane < end; lane++)
            states[pose + lane] = solved[lane] ? 1 : near[lane] ? 2 : 0;
    }
}
