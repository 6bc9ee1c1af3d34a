/* Solves a file of problems with HPIPM and writes times, iterations and inputs.
 *
 * Augmented form, the one that suits HPIPM best: states s = [x, u_prev] (9), controls v = u - u_prev (2), x_0
 * eliminated, bounds on v and s as boxes, the track as a general row, soft rows with slacks. Only the solver's own
 * call is timed, setting the data is not. Numbers are float64 in the order in which they are read below.
 *
 * usage: hpipm problems results horizon count warm_start tolerance repeats
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <blasfeo_d_aux_ext_dep.h>
#include <hpipm_d_ocp_qp.h>
#include <hpipm_d_ocp_qp_dim.h>
#include <hpipm_d_ocp_qp_ipm.h>
#include <hpipm_d_ocp_qp_sol.h>

enum { NS = 9, NV = 2, SOFT = 5 };

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

static void read_doubles(FILE *file, double *to, size_t count) {
    if (fread(to, sizeof(double), count, file) != count) {
        fprintf(stderr, "the file of problems ends early\n");
        exit(1);
    }
}

static void *space(size_t bytes) {
    void *memory = calloc(1, bytes + 64);
    if (!memory) exit(1);
    return memory;
}

/* Copies the numbers of one vector to another of the same length. */
static void copy(struct blasfeo_dvec *from, struct blasfeo_dvec *to, int length) {
    memcpy(to->pa, from->pa, sizeof(double) * length);
}

/* The solution one period on: stage t takes what stage t + 1 had, the last two stay. */
static void shift(struct d_ocp_qp_dim *dim, struct d_ocp_qp_sol *sol) {
    int horizon = dim->N;
    int rows = NV + 6 + 1; /* two-sided rows of an inner stage */
    for (int t = 0; t + 2 < horizon; t++) {
        struct blasfeo_dvec *triple[3] = {sol->ux, sol->lam, sol->t};
        for (int k = 0; k < 3; k++) {
            struct blasfeo_dvec *from = triple[k] + t + 1, *to = triple[k] + t;
            if (t > 0) {
                copy(from, to, to->m);
            } else { /* stage 0 has controls and their bounds only */
                copy(from, to, NV);
                if (k > 0) memcpy(to->pa + NV, from->pa + rows, sizeof(double) * NV);
            }
        }
        copy(sol->pi + t + 1, sol->pi + t, sol->pi[t].m);
    }
}

static void duplicate(struct d_ocp_qp_dim *dim, struct d_ocp_qp_sol *from, struct d_ocp_qp_sol *to) {
    for (int t = 0; t <= dim->N; t++) {
        copy(from->ux + t, to->ux + t, to->ux[t].m);
        copy(from->lam + t, to->lam + t, to->lam[t].m);
        copy(from->t + t, to->t + t, to->t[t].m);
        if (t < dim->N) copy(from->pi + t, to->pi + t, to->pi[t].m);
    }
}

int main(int argc, char **argv) {
    if (argc != 8) {
        fprintf(stderr, "usage: hpipm problems results horizon count warm_start tolerance repeats\n");
        return 1;
    }
    FILE *in = fopen(argv[1], "rb"), *out = fopen(argv[2], "wb");
    int horizon = atoi(argv[3]), count = atoi(argv[4]), warm_start = atoi(argv[5]), repeats = atoi(argv[7]);
    double tolerance = atof(argv[6]);
    if (!in || !out) {
        perror("hpipm");
        return 1;
    }

    struct d_ocp_qp_dim dim;
    d_ocp_qp_dim_create(horizon, &dim, space(d_ocp_qp_dim_memsize(horizon)));
    for (int t = 0; t <= horizon; t++) {
        d_ocp_qp_dim_set_nx(t, t ? NS : 0, &dim);
        d_ocp_qp_dim_set_nu(t, t < horizon ? NV : 0, &dim);
        d_ocp_qp_dim_set_nbx(t, t ? 6 : 0, &dim);
        d_ocp_qp_dim_set_nbu(t, t < horizon ? NV : 0, &dim);
        d_ocp_qp_dim_set_ng(t, t ? 1 : 0, &dim);
        d_ocp_qp_dim_set_ns(t, t ? SOFT : 0, &dim);
        d_ocp_qp_dim_set_nsbx(t, t ? SOFT - 1 : 0, &dim);
        d_ocp_qp_dim_set_nsbu(t, 0, &dim);
        d_ocp_qp_dim_set_nsg(t, t ? 1 : 0, &dim);
    }
    struct d_ocp_qp qp;
    d_ocp_qp_create(&dim, &qp, space(d_ocp_qp_memsize(&dim)));
    struct d_ocp_qp_sol sol, start;
    d_ocp_qp_sol_create(&dim, &sol, space(d_ocp_qp_sol_memsize(&dim)));
    d_ocp_qp_sol_create(&dim, &start, space(d_ocp_qp_sol_memsize(&dim)));
    struct d_ocp_qp_ipm_arg arg;
    d_ocp_qp_ipm_arg_create(&dim, &arg, space(d_ocp_qp_ipm_arg_memsize(&dim)));
    d_ocp_qp_ipm_arg_set_default(SPEED, &arg);
    int limit = 200;
    d_ocp_qp_ipm_arg_set_iter_max(&limit, &arg);
    d_ocp_qp_ipm_arg_set_tol_stat(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_tol_eq(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_tol_ineq(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_tol_comp(&tolerance, &arg);
    struct d_ocp_qp_ipm_ws ws;
    d_ocp_qp_ipm_ws_create(&dim, &arg, &ws, space(d_ocp_qp_ipm_ws_memsize(&dim, &arg)));

    for (int n = 0; n < count; n++) {
        double first, u_prev[NV], zero[NV] = {0, 0};
        read_doubles(in, &first, 1);
        read_doubles(in, u_prev, NV);
        for (int t = 0; t < horizon; t++) {
            /* A is left out at stage 0, whose b holds A s_0. */
            double a[NS * NS], b[NS * NV], offset[NS], rate[NV * NV], dv[2][NV];
            read_doubles(in, a, NS * NS);
            read_doubles(in, b, NS * NV);
            read_doubles(in, offset, NS);
            read_doubles(in, rate, NV * NV);
            read_doubles(in, dv[0], NV);
            read_doubles(in, dv[1], NV);
            if (t) d_ocp_qp_set_A(t, a, &qp);
            d_ocp_qp_set_B(t, b, &qp);
            d_ocp_qp_set_b(t, offset, &qp);
            d_ocp_qp_set_R(t, rate, &qp);
            d_ocp_qp_set_r(t, zero, &qp);
            int inputs[NV] = {0, 1};
            d_ocp_qp_set_idxbu(t, inputs, &qp);
            d_ocp_qp_set_lbu(t, dv[0], &qp);
            d_ocp_qp_set_ubu(t, dv[1], &qp);

            /* Cost and rows of the state after it. */
            double q[NS * NS], gradient[NS], box[2][6], track[NS], edge[2], linear[SOFT], quadratic[SOFT];
            read_doubles(in, q, NS * NS);
            read_doubles(in, gradient, NS);
            read_doubles(in, box[0], 6);
            read_doubles(in, box[1], 6);
            read_doubles(in, track, NS);
            read_doubles(in, edge, 2);
            read_doubles(in, linear, SOFT);
            read_doubles(in, quadratic, SOFT);
            int s = t + 1, controls = s < horizon ? NV : 0;
            int boxed[6] = {2, 4, 5, 6, 7, 8}; /* v_x, v_y, omega, delta, inputs */
            int soft[SOFT] = {controls, controls + 1, controls + 2, controls + 3, controls + 6};
            d_ocp_qp_set_Q(s, q, &qp);
            d_ocp_qp_set_q(s, gradient, &qp);
            d_ocp_qp_set_idxbx(s, boxed, &qp);
            d_ocp_qp_set_lbx(s, box[0], &qp);
            d_ocp_qp_set_ubx(s, box[1], &qp);
            d_ocp_qp_set_C(s, track, &qp);
            d_ocp_qp_set_lg(s, edge, &qp);
            d_ocp_qp_set_ug(s, edge + 1, &qp);
            d_ocp_qp_set_idxs(s, soft, &qp);
            d_ocp_qp_set_zl(s, linear, &qp);
            d_ocp_qp_set_zu(s, linear, &qp);
            d_ocp_qp_set_Zl(s, quadratic, &qp);
            d_ocp_qp_set_Zu(s, quadratic, &qp);
        }
        int warm = first != 0.0 ? 0 : warm_start;
        d_ocp_qp_ipm_arg_set_warm_start(&warm, &arg);
        if (warm) {
            shift(&dim, &sol);
            duplicate(&dim, &sol, &start);
        }
        double best = 1e9;
        for (int k = 0; k < repeats; k++) {
            if (warm) duplicate(&dim, &start, &sol);
            double begin = seconds();
            d_ocp_qp_ipm_solve(&qp, &sol, &arg, &ws);
            double taken = seconds() - begin;
            if (taken < best) best = taken;
        }
        int status, iterations;
        d_ocp_qp_ipm_get_status(&ws, &status);
        d_ocp_qp_ipm_get_iter(&ws, &iterations);
        double head[3] = {best, iterations, status};
        fwrite(head, sizeof(double), 3, out);
        for (int t = 1; t <= horizon; t++) {
            double s[NS];
            d_ocp_qp_sol_get_x(t, &sol, s);
            fwrite(s + 7, sizeof(double), NV, out);
        }
    }
    return fclose(out);
}
