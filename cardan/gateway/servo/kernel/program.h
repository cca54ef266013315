/*
 * A small strictly convex quadratic program:
 *
 *     min  1/2 x'Hx + f'x    subject to  lowest <= x <= highest,  row . x >= least (soft)
 *
 * by a dual active set (Goldfarb and Idnani 1983; Arnstroem, Bemporad and Axehill 2022), warm from
 * the constraints that were active before. A soft row may be violated by e at the price
 * e^2 / (2 SOFTNESS (a' inv(H) a)), as daqp has it; bounds may not, so there always is a solution.
 */
#ifndef CARDAN_SERVO_PROGRAM_H
#define CARDAN_SERVO_PROGRAM_H

#include "chain.h"

#define MAX_PARTS 3 /* of a twist, each with a speed of its own */
#define MAX_UNKNOWNS (MAX_JOINTS + MAX_PARTS)
#define MAX_ROWS 16
#define MAX_CONSTRAINTS (MAX_UNKNOWNS + MAX_ROWS)

/* Constraints added or taken out in one solution, at most. Random ticks, which collide more than any
 * arm does, need 70 at most in their one or two programs. */
#define MAX_ITERATIONS 120

#define SOFTNESS 1e-6

typedef struct {
    /* What is to be solved. */
    int unknowns, rows;
    double hessian[MAX_UNKNOWNS][MAX_UNKNOWNS]; /* the lower triangle is read */
    double linear[MAX_UNKNOWNS];
    double lowest[MAX_UNKNOWNS], highest[MAX_UNKNOWNS];
    double row[MAX_ROWS][MAX_UNKNOWNS];
    double least[MAX_ROWS];
    int row_name[MAX_ROWS]; /* whatever tells rows apart from one program to the next; >= 0 */

    /* The solution. */
    double x[MAX_UNKNOWNS];
    double multiplier[MAX_CONSTRAINTS]; /* of bounds, then rows; negative at an upper bound */
    int iterations;

    /* The active constraints of the last solution, for the next: -1 - i for the bound of unknown i,
     * or the name of a row. */
    int warm_count;
    int warm_name[MAX_CONSTRAINTS];
    double warm_multiplier[MAX_CONSTRAINTS];

    /* In coordinates y in which the cost is |y|^2 / 2: unit normals and bounds of constraints. */
    double factor[MAX_UNKNOWNS][MAX_UNKNOWNS], inverse[MAX_UNKNOWNS][MAX_UNKNOWNS];
    double shift[MAX_UNKNOWNS], y[MAX_UNKNOWNS];
    double normal[MAX_CONSTRAINTS][MAX_UNKNOWNS], size[MAX_CONSTRAINTS];
    double low[MAX_CONSTRAINTS], high[MAX_CONSTRAINTS];

    /* Working set, its Gram matrix and its factors L D L'. */
    int count, member[MAX_CONSTRAINTS], is_high[MAX_CONSTRAINTS], position[MAX_CONSTRAINTS];
    double lambda[MAX_CONSTRAINTS], target[MAX_CONSTRAINTS];
    double gram[MAX_CONSTRAINTS][MAX_CONSTRAINTS];
    double lower[MAX_CONSTRAINTS][MAX_CONSTRAINTS], diagonal[MAX_CONSTRAINTS];
} Program;

enum {
    PROGRAM_SOLVED = 0,
    PROGRAM_NOT_CONVEX = 1, /* or not numbers */
    PROGRAM_NO_END = 2      /* MAX_ITERATIONS were not enough */
};

/* Forget the constraints that were active. */
void program_forget(Program *program);

int program_solve(Program *program);

#endif
