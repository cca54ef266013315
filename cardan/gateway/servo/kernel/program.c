#include "program.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "vectors.h"

/* Violation that counts as none, relative to the size of the solution; some thousand times the
 * rounding of a product of eleven. */
#define PRIMAL_TOLERANCE 1e-12

#define ROUNDING 1e-15

/* Multipliers of the wrong sign by less are zero, relative to the largest. */
#define DUAL_TOLERANCE 1e-13

/* Violation, in normalized units, at which a solution is taken that more steps did not improve. */
#define ACCEPTED 1e-7

/* Squared size of a row, in units of the cost, that is rounding; daqp's tolerance of zero. */
#define NEGLIGIBLE 1e-11

/* A pivot of the working set smaller than this is of constraints that say the same. */
#define DEPENDENT 1e-15

void program_forget(Program *p)
{
    p->warm_count = 0;
}

static double product(int n, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* H = C C', the inverse of C, and C^-1 f. */
static bool factorize(Program *p)
{
    int n = p->unknowns;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < i; j++)
            p->factor[i][j] = (p->hessian[i][j] - product(j, p->factor[i], p->factor[j])) *
                              p->inverse[j][j];
        double square = p->hessian[i][i] - product(i, p->factor[i], p->factor[i]);
        if (!(square > 0.0) || !isfinite(square))
            return false;
        p->factor[i][i] = sqrt(square);
        p->inverse[i][i] = 1.0 / p->factor[i][i];
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < i; j++) {
            double sum = 0.0;
            for (int k = j; k < i; k++)
                sum += p->factor[i][k] * p->inverse[k][j];
            p->inverse[i][j] = -sum * p->inverse[i][i];
        }
        p->shift[i] = product(i + 1, p->inverse[i], p->linear);
    }
    return isfinite(product(n, p->shift, p->shift));
}

static void transform(Program *p)
{
    int n = p->unknowns;
    for (int i = 0; i < n; i++) {
        double square = 0.0, at = 0.0;
        for (int k = 0; k < n; k++) {
            double value = k < i ? 0.0 : p->inverse[k][i];
            p->normal[i][k] = value;
            square += value * value;
            at += value * p->shift[k];
        }
        double size = sqrt(square), share = 1.0 / size;
        for (int k = i; k < n; k++)
            p->normal[i][k] *= share;
        p->size[i] = size;
        p->low[i] = (p->lowest[i] + at) * share;
        p->high[i] = (p->highest[i] + at) * share;
    }
    for (int r = 0; r < p->rows; r++) {
        int i = n + r;
        double square = 0.0, at = 0.0;
        for (int k = 0; k < n; k++) {
            double value = product(k + 1, p->inverse[k], p->row[r]);
            p->normal[i][k] = value;
            square += value * value;
            at += value * p->shift[k];
        }
        p->size[i] = sqrt(square);
        p->high[i] = INFINITY;
        /* A row that no unknown can change constrains nothing: of a body that turns about its own
         * axis, rounding is left. */
        bool acts = square > NEGLIGIBLE;
        double share = acts ? 1.0 / p->size[i] : 0.0;
        for (int k = 0; k < n; k++)
            p->normal[i][k] *= share;
        p->low[i] = acts ? (p->least[r] + at) * share : -INFINITY;
    }
}

/* Rows of the factors from `first` on, from the Gram matrix. */
static bool refactorize(Program *p, int first)
{
    for (int i = first; i < p->count; i++) {
        double scaled[MAX_CONSTRAINTS], pivot = p->gram[i][i];
        for (int j = 0; j < i; j++) {
            scaled[j] = p->gram[i][j] - product(j, scaled, p->lower[j]);
            p->lower[i][j] = scaled[j] / p->diagonal[j];
            pivot -= scaled[j] * p->lower[i][j];
        }
        if (!(pivot > DEPENDENT))
            return false;
        p->diagonal[i] = pivot;
    }
    return true;
}

/* False, and nothing is changed, where the constraint depends on those that are in. */
static bool add(Program *p, int constraint, bool is_high, double lambda)
{
    int n = p->unknowns, last = p->count;
    for (int j = 0; j < last; j++)
        p->gram[last][j] = product(n, p->normal[constraint], p->normal[p->member[j]]);
    p->gram[last][last] = constraint < n ? 1.0 : 1.0 + SOFTNESS;
    p->count = last + 1;
    if (!refactorize(p, last)) {
        p->count = last;
        return false;
    }
    p->member[last] = constraint;
    p->is_high[last] = is_high;
    p->lambda[last] = lambda;
    p->position[constraint] = last;
    return true;
}

static bool take_out(Program *p, int place)
{
    p->position[p->member[place]] = -1;
    p->count--;
    for (int i = place; i < p->count; i++) {
        p->member[i] = p->member[i + 1];
        p->is_high[i] = p->is_high[i + 1];
        p->lambda[i] = p->lambda[i + 1];
        p->position[p->member[i]] = i;
        for (int j = 0; j < place; j++)
            p->gram[i][j] = p->gram[i + 1][j];
        for (int j = place; j <= i; j++)
            p->gram[i][j] = p->gram[i + 1][j + 1];
    }
    return refactorize(p, place);
}

/* The bound at which a member of the working set is held. */
static double bound_of(const Program *p, int place)
{
    int constraint = p->member[place];
    return p->is_high[place] ? p->high[constraint] : p->low[constraint];
}

/* b from L D L' x = b, in place; the largest size of an entry. */
static double substitute(const Program *p, double *b)
{
    double largest = 0.0;
    for (int i = 0; i < p->count; i++)
        b[i] -= product(i, p->lower[i], b);
    for (int i = p->count - 1; i >= 0; i--) {
        double sum = b[i] / p->diagonal[i];
        for (int j = i + 1; j < p->count; j++)
            sum -= p->lower[j][i] * b[j];
        b[i] = sum;
        largest = larger(fabs(sum), largest);
    }
    return largest;
}

/* Multipliers with which all of the working set hold with equality. */
static double solve_working_set(Program *p)
{
    for (int i = 0; i < p->count; i++)
        p->target[i] = bound_of(p, i);
    return substitute(p, p->target);
}

/* y of the multipliers. */
static void set_y(Program *p)
{
    for (int k = 0; k < p->unknowns; k++)
        p->y[k] = 0.0;
    for (int i = 0; i < p->count; i++)
        for (int k = 0; k < p->unknowns; k++)
            p->y[k] += p->lambda[i] * p->normal[p->member[i]][k];
}

/* One step of iterative refinement: near a singularity, and where soft rows are violated, the
 * multipliers are large and cancel. */
static void refine(Program *p)
{
    for (int i = 0; i < p->count; i++) {
        int constraint = p->member[i];
        p->target[i] = bound_of(p, i) - product(p->unknowns, p->normal[constraint], p->y);
        if (constraint >= p->unknowns)
            p->target[i] -= SOFTNESS * p->lambda[i];
    }
    substitute(p, p->target);
    for (int i = 0; i < p->count; i++)
        p->lambda[i] += p->target[i];
    set_y(p);
}

/* The member whose multiplier turns its sign first on the way to the target, or -1. */
static int blocking(const Program *p, double tolerance, double *share)
{
    int found = -1;
    *share = INFINITY;
    for (int i = 0; i < p->count; i++) {
        double sign = p->is_high[i] ? -1.0 : 1.0;
        double target = sign * p->target[i], now = larger(sign * p->lambda[i], 0.0);
        if (target >= -tolerance)
            continue;
        double here = now / (now - target);
        if (here < *share) {
            *share = here;
            found = i;
        }
    }
    return found;
}

/* The constraint that is violated most, its side, and by how much; -1 where none is. */
static int most_violated(const Program *p, double tolerance, bool *is_high, double *violation)
{
    int found = -1, end = p->unknowns + p->rows;
    *violation = tolerance;
    for (int i = 0; i < end; i++) {
        if (p->position[i] >= 0)
            continue;
        double at = product(p->unknowns, p->normal[i], p->y);
        if (p->low[i] - at > *violation) {
            *violation = p->low[i] - at;
            *is_high = false;
            found = i;
        } else if (at - p->high[i] > *violation) {
            *violation = at - p->high[i];
            *is_high = true;
            found = i;
        }
    }
    return found;
}

static void start_warm(Program *p)
{
    int n = p->unknowns, end = n + p->rows;
    p->count = 0;
    for (int i = 0; i < end; i++)
        p->position[i] = -1;
    for (int w = 0; w < p->warm_count; w++) {
        int constraint = -1;
        if (p->warm_name[w] < 0) {
            constraint = -1 - p->warm_name[w];
            if (constraint >= n)
                continue;
        } else {
            for (int r = 0; r < p->rows && constraint < 0; r++)
                if (p->row_name[r] == p->warm_name[w])
                    constraint = n + r;
        }
        if (constraint < 0 || p->position[constraint] >= 0)
            continue;
        bool is_high = p->warm_multiplier[w] < 0.0;
        double bound = is_high ? p->high[constraint] : p->low[constraint];
        if (isfinite(bound))
            add(p, constraint, is_high, p->warm_multiplier[w]);
    }
}

static void finish(Program *p)
{
    int n = p->unknowns, end = n + p->rows;
    refine(p);
    /* x = C'^-1 (y - C^-1 f) */
    for (int i = 0; i < n; i++)
        p->y[i] -= p->shift[i];
    for (int i = 0; i < n; i++) {
        double sum = 0.0;
        for (int k = i; k < n; k++)
            sum += p->inverse[k][i] * p->y[k];
        p->x[i] = sum;
    }
    for (int i = 0; i < end; i++)
        p->multiplier[i] = 0.0;
    p->warm_count = p->count;
    for (int i = 0; i < p->count; i++) {
        int constraint = p->member[i];
        double lambda = p->lambda[i];
        p->multiplier[constraint] = lambda / p->size[constraint];
        p->warm_multiplier[i] = lambda;
        p->warm_name[i] = constraint < n ? -1 - constraint : p->row_name[constraint - n];
        if (constraint < n)
            p->x[constraint] = p->is_high[i] ? p->highest[constraint] : p->lowest[constraint];
    }
    /* Rounding must not push a joint past its limit. */
    for (int i = 0; i < n; i++)
        p->x[i] = smaller(larger(p->x[i], p->lowest[i]), p->highest[i]);
}

int program_solve(Program *p)
{
    int n = p->unknowns;
    p->iterations = 0;
    if (!factorize(p)) {
        program_forget(p);
        return PROGRAM_NOT_CONVEX;
    }
    transform(p);
    start_warm(p);
    int excluded = -1;
    while (p->iterations < MAX_ITERATIONS) {
        p->iterations++;
        double share, largest = solve_working_set(p);
        int out = blocking(p, DUAL_TOLERANCE * largest, &share);
        if (out >= 0) {
            for (int i = 0; i < p->count; i++)
                p->lambda[i] += share * (p->target[i] - p->lambda[i]);
            /* One that leaves as it came in would come in again for ever: it is satisfied but for
             * rounding. */
            excluded = share == 0.0 && out == p->count - 1 ? p->member[out] : -1;
            if (!take_out(p, out))
                break;
            continue;
        }
        memcpy(p->lambda, p->target, (size_t)p->count * sizeof p->lambda[0]);
        set_y(p);
        double size = sqrt(product(n, p->y, p->y) + product(n, p->shift, p->shift)), violation;
        if (!isfinite(size))
            break;
        bool is_high = false;
        /* Large multipliers that cancel leave their rounding in y. */
        double tolerance = PRIMAL_TOLERANCE * (1.0 + size) + ROUNDING * largest;
        int in = most_violated(p, tolerance, &is_high, &violation);
        if (in < 0 || (in == excluded && violation < ACCEPTED)) {
            finish(p);
            return PROGRAM_SOLVED;
        }
        if (!add(p, in, is_high, 0.0)) {
            if (violation >= ACCEPTED)
                break;
            finish(p);
            return PROGRAM_SOLVED;
        }
    }
    program_forget(p);
    return PROGRAM_NO_END;
}
