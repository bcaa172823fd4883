/* Rows B^T x with A^T x = g at poses `first` to `end`, for each of `channels` right sides.

   Outputs of the function: A (ROWS, ROWS), and the row B^T x, which takes x as last input.

   scale      (ROWS,) units of A's columns, for the condition number
   right      (n, channels, ROWS) right sides g
   rows       (n, channels, COLUMNS) results
   condition  (n,) bounds on the condition numbers of A, from its norm and determinant */
#define COLUMNS (OUTPUT_ENTRIES - ROWS * ROWS)

static vec condition_bound(const vec *matrix, const factors *f, const double *scale)
{
    vec square = splat(0.0), volume = splat(1.0);
    for (int j = 0; j < ROWS; j++)
        for (int i = 0; i < ROWS; i++) {
            vec entry = matrix[j * ROWS + i] * splat(scale[j]);
            square += entry * entry;
        }
    for (int k = 0; k < ROWS; k++) {
        volume *= f->entry[k][k] / splat(scale[k]);
        volume *= square_root(square);
        if (k > 0)
            volume /= splat(sqrt(ROWS - 1.0));
    }
    return absolute(volume);
}

void pkm_adjoint(
    int64_t first, int64_t end, int64_t inner, const input *inputs,
    const double *constants, const double *scale, int64_t channels, const double *right,
    double *rows, double *condition)
{
    vec in[INPUT_ENTRIES + 1], fixed[FIXED_ENTRIES + 1], out[OUTPUT_ENTRIES + 1];
    vec *factor = in + INPUT_ENTRIES - ROWS;
    factors f;
    for (int64_t pose = first; pose < end; pose += LANES) {
        load(inputs, INPUTS - 1, inner, pose, end, in);
        prepare(in, constants, fixed, out);
        factorise(out, 1, &f);
        vec bound = condition_bound(out, &f, scale);
        store(&bound, 1, pose, end, condition);
        for (int64_t channel = 0; channel < channels; channel++) {
            const input side = {right + channel * ROWS, channels * ROWS, 0, ROWS};
            load(&side, 1, 1, pose, end, factor);
            substitute(&f, factor);
            every_output(in, constants, fixed, out);
            for (int lane = 0; lane < LANES && pose + lane < end; lane++) {
                const double *entry = (const double *)(out + ROWS * ROWS) + lane;
                double *row = rows + ((pose + lane) * channels + channel) * COLUMNS;
                for (int64_t i = 0; i < COLUMNS; i++)
                    row[i] = entry[i * LANES];
            }
        }
    }
}
