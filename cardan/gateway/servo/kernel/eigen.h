/* Eigenvalues of small symmetric matrices. */
#ifndef CARDAN_SERVO_EIGEN_H
#define CARDAN_SERVO_EIGEN_H

#include "chain.h"

/*
 * Eigenvalues of the symmetric `matrix` (n x n, n <= MAX_JOINTS), ascending, and where `vectors` is
 * not NULL its eigenvectors as columns. Householder's tridiagonal form and implicit QL steps
 * (Golub and Van Loan, 8.3); false when a value takes more than EIGEN_STEPS steps.
 */
#define EIGEN_STEPS 40
int eigen_symmetric(int n, const double matrix[MAX_JOINTS][MAX_JOINTS], double values[MAX_JOINTS],
                    double (*vectors)[MAX_JOINTS]);

/*
 * The smallest eigenvalue of the positive semidefinite `matrix` (n x n), which is overwritten; 0 where
 * that is 0 but for rounding. Householder's tridiagonal form, and Laguerre's steps from 0 on its
 * characteristic polynomial (Parlett 1964), which come near it from below: EIGEN_STEPS at most.
 */
double eigen_smallest(int n, double matrix[MAX_JOINTS][MAX_JOINTS]);

#endif
