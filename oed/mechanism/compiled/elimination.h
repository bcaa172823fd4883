/* Gaussian elimination of a matrix (ROWS, ROWS) in each lane, with partial pivoting.

   The lanes choose their pivots each for itself. Most often they agree, and rows that no
   lane exchanges cost one comparison. `systems.py` does the same operations, to the digit. */

typedef struct {
    vec entry[ROWS][ROWS]; /* L below, U above, one over U's diagonal on it */
    mask swapped[ROWS][ROWS];
} factors;

static inline void exchange(mask condition, vec *x, vec *y)
{
    vec first = *x, second = *y;
    *x = choose(condition, second, first);
    *y = choose(condition, first, second);
}

/* Factors of a matrix that lies column by column, or of its transpose. */
static void factorise(const vec *matrix, int transposed, factors *f)
{
    for (int i = 0; i < ROWS; i++)
        for (int j = 0; j < ROWS; j++)
            f->entry[i][j] = matrix[transposed ? i * ROWS + j : j * ROWS + i];
    for (int k = 0; k < ROWS; k++) {
        mask best = {0};
        vec largest = absolute(f->entry[k][k]);
        for (int i = k + 1; i < ROWS; i++) {
            vec size = absolute(f->entry[i][k]);
            mask larger = size > largest;
            largest = choose(larger, size, largest);
            best = (i & larger) | (best & ~larger);
        }
        for (int i = k + 1; i < ROWS; i++) {
            f->swapped[k][i] = best == i;
            if (any(f->swapped[k][i]))
                for (int j = 0; j < ROWS; j++)
                    exchange(f->swapped[k][i], &f->entry[k][j], &f->entry[i][j]);
        }
        vec inverse = splat(1.0) / f->entry[k][k];
        f->entry[k][k] = inverse;
        for (int i = k + 1; i < ROWS; i++) {
            vec factor = f->entry[i][k] * inverse;
            f->entry[i][k] = factor;
            for (int j = k + 1; j < ROWS; j++)
                f->entry[i][j] -= factor * f->entry[k][j];
        }
    }
}

/* Replace a right side by the solution. */
static void substitute(const factors *f, vec *x)
{
    for (int k = 0; k < ROWS; k++)
        for (int i = k + 1; i < ROWS; i++)
            if (any(f->swapped[k][i]))
                exchange(f->swapped[k][i], &x[k], &x[i]);
    for (int k = 0; k < ROWS; k++)
        for (int i = k + 1; i < ROWS; i++)
            x[i] -= f->entry[i][k] * x[k];
    for (int k = ROWS - 1; k >= 0; k--) {
        x[k] *= f->entry[k][k];
        for (int i = 0; i < k; i++)
            x[i] -= f->entry[i][k] * x[k];
    }
}
