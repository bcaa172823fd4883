/* Outputs of the function at poses `first` to `end` of `count`: rows of one output after
   those of the other. */
void pkm_evaluate(
    int64_t first, int64_t end, int64_t inner, const input *inputs,
    const double *constants, int64_t count, double *outputs)
{
    vec in[INPUT_ENTRIES + 1], fixed[FIXED_ENTRIES + 1], out[OUTPUT_ENTRIES + 1];
    for (int64_t pose = first; pose < end; pose += LANES) {
        load(inputs, INPUTS, inner, pose, end, in);
        prepare(in, constants, fixed, out);
        const vec *part = out;
        double *rows = outputs;
        for (int k = 0; k < OUTPUTS; k++) {
            store(part, OUTPUT_SIZES[k], pose, end, rows);
            part += OUTPUT_SIZES[k];
            rows += OUTPUT_SIZES[k] * count;
        }
    }
}
