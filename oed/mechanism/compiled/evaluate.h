/* Outputs of the function at poses `first` to `end`; one array of rows for each output. */
void pkm_evaluate(
    int64_t first, int64_t end, int64_t inner, const input *inputs,
    const double *constants, double *const *outputs)
{
    vec in[INPUT_ENTRIES + 1], fixed[FIXED_ENTRIES + 1], out[OUTPUT_ENTRIES + 1];
    for (int64_t pose = first; pose < end; pose += LANES) {
        load(inputs, INPUTS, inner, pose, end, in);
        prepare(in, constants, fixed, out);
        const vec *part = out;
        for (int k = 0; k < OUTPUTS; k++) {
            store(part, OUTPUT_SIZES[k], pose, end, outputs[k]);
            part += OUTPUT_SIZES[k];
        }
    }
}
