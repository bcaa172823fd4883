/* Newton's method, for all machines alike. */

#include <stddef.h>

enum { PKM_Z = PKM_X + PKM_Q, PKM_STEPS = 30 };

static const double pkm_step_tolerance = 1e-8;
static const double pkm_no_tool[3] = {0.0, 0.0, 0.0};

/* A work space a call: the functions are reentrant. */
typedef struct {
  const double *arg[4];
  double *res[2];
  double w[PKM_REALS];
  int iw[PKM_WHOLE];
  double value[PKM_Z];
  double slope[PKM_Z * PKM_Z];
} pkm_work;

/* Solve slope step = value, n x n, column by column, with partial pivots; the result
   replaces value. Returns the sign of the determinant, 0 where the slope is singular. */
static int pkm_linear(int n, double *slope, double *value) {
  int sign = 1;
  for (int k = 0; k < n; k++) {
    int pivot = k;
    for (int i = k + 1; i < n; i++) {
      if (fabs(slope[i + n * k]) > fabs(slope[pivot + n * k])) pivot = i;
    }
    double top = slope[pivot + n * k];
    if (!(fabs(top) > 0.0)) return 0;
    if (pivot != k) {
      sign = -sign;
      for (int j = 0; j < n; j++) {
        double other = slope[k + n * j];
        slope[k + n * j] = slope[pivot + n * j];
        slope[pivot + n * j] = other;
      }
      double other = value[k];
      value[k] = value[pivot];
      value[pivot] = other;
    }
    if (top < 0.0) sign = -sign;
    for (int i = k + 1; i < n; i++) {
      double factor = slope[i + n * k] / top;
      if (factor == 0.0) continue;
      for (int j = k + 1; j < n; j++) slope[i + n * j] -= factor * slope[k + n * j];
      value[i] -= factor * value[k];
    }
  }
  for (int k = n - 1; k >= 0; k--) {
    for (int j = k + 1; j < n; j++) value[k] -= slope[k + n * j] * value[j];
    value[k] /= slope[k + n * k];
  }
  return sign;
}

/* One step of z (n); its first entries move by no more than the longest step. Returns
   the size of the step, -1 where there is none. */
static double pkm_step(int n, int limited, double *z, pkm_work *work) {
  double size = 0.0, move = 0.0;
  if (!pkm_linear(n, work->slope, work->value)) return -1.0;
  for (int i = 0; i < n; i++) {
    double step = fabs(work->value[i]);
    if (!(step < 1e300)) return -1.0;
    if (step > size) size = step;
    if (i < limited && step > move) move = step;
  }
  double factor = move > PKM_LONGEST_STEP ? PKM_LONGEST_STEP / move : 1.0;
  for (int i = 0; i < n; i++) z[i] -= factor * work->value[i];
  return size;
}

static void pkm_unmet_at(
    const double *z, const double *command, const double *tool, pkm_work *work) {
  work->arg[0] = z;
  work->arg[1] = z + PKM_X;
  work->arg[2] = command;
  work->arg[3] = tool;
  work->res[0] = work->value;
  work->res[1] = work->slope;
  pkm_unmet(work->arg, work->res, work->iw, work->w, 0);
}

static int pkm_differ(double value, int sign) {
  return value * sign < 0.0;
}

/* Whether pose and joints are in another assembly mode than home. */
static int pkm_pose_differs(const double *pose, const double *joints, pkm_work *work) {
  double own[PKM_Q];
  work->arg[0] = pose;
  work->arg[1] = joints;
  work->res[0] = work->slope;
  work->res[1] = own;
  pkm_mode(work->arg, work->res, work->iw, work->w, 0);
  for (int k = 0; k < PKM_Q; k++) {
    if (pkm_differ(own[k], pkm_home_mode[2 + k])) return 1;
  }
  if (PKM_PHI != PKM_X) return 0;
  return pkm_differ(pkm_linear(PKM_X, work->slope, work->value), pkm_home_mode[0]);
}

int pkm_inverse(
    const double *command, const double *tool, double *pose, double *joints) {
  pkm_work work;
  double z[PKM_Z];
  double size = -1.0;
  if (!tool) tool = pkm_no_tool;
  work.arg[0] = command;
  work.arg[1] = tool;
  work.res[0] = z;
  work.res[1] = z + PKM_X;
  pkm_start(work.arg, work.res, work.iw, work.w, 0);
  for (int k = 0; k < PKM_STEPS; k++) {
    pkm_unmet_at(z, command, tool, &work);
    size = pkm_step(PKM_Z, PKM_X, z, &work);
    if (size < 0.0) return PKM_NOT_ASSEMBLED;
    if (size <= pkm_step_tolerance) break;
  }
  if (!(size <= pkm_step_tolerance)) return PKM_NOT_ASSEMBLED;
  pkm_unmet_at(z, command, tool, &work);
  if (pkm_differ(pkm_linear(PKM_Z, work.slope, work.value), pkm_home_mode[1])
      || pkm_pose_differs(z, z + PKM_X, &work)) {
    return PKM_OTHER_MODE;
  }
  for (int i = 0; pose && i < PKM_X; i++) pose[i] = z[i];
  for (int k = 0; k < PKM_Q; k++) joints[k] = z[PKM_X + k];
  return PKM_OK;
}

/* Command that a pose is, from one nearby. Where a coordinate has no meaning there, as
   the direction of a tilt of zero, it stays. */
static int pkm_command_of(
    const double *pose, const double *tool, double *command, pkm_work *work) {
  double goal[PKM_C], target[PKM_C], slope[PKM_C * PKM_C], size = 0.0;
  work->arg[0] = pose;
  work->arg[1] = tool;
  work->res[0] = goal;
  pkm_held(work->arg, work->res, work->iw, work->w, 0);
  for (int step = 0; step < PKM_STEPS; step++) {
    work->arg[0] = command;
    work->res[0] = target;
    work->res[1] = slope;
    pkm_wanted(work->arg, work->res, work->iw, work->w, 0);
    for (int i = 0; i < PKM_C; i++) {
      work->value[i] = 0.0;
      for (int k = 0; k < PKM_C; k++) {
        work->value[i] += slope[k + PKM_C * i] * (target[k] - goal[k]);
      }
      for (int j = 0; j < PKM_C; j++) {
        double sum = i == j ? 1e-24 : 0.0;
        for (int k = 0; k < PKM_C; k++) {
          sum += slope[k + PKM_C * i] * slope[k + PKM_C * j];
        }
        work->slope[i + PKM_C * j] = sum;
      }
    }
    size = pkm_step(PKM_C, 0, command, work);
    if (size < 0.0) return PKM_NOT_ASSEMBLED;
    if (size <= 1e-12) return PKM_OK;
  }
  return PKM_NOT_ASSEMBLED;
}

int pkm_forward(
    const double *joints, const double *tool, double *pose, double *command) {
  pkm_work work;
  double x[PKM_X], c[PKM_C];
  double size = -1.0;
  if (!tool) tool = pkm_no_tool;
  for (int i = 0; i < PKM_X; i++) x[i] = pose[i];
  for (int k = 0; k < PKM_STEPS; k++) {
    work.arg[0] = x;
    work.arg[1] = joints;
    work.res[0] = work.value;
    work.res[1] = work.slope;
    pkm_balance(work.arg, work.res, work.iw, work.w, 0);
    size = pkm_step(PKM_X, PKM_X, x, &work);
    if (size < 0.0) return PKM_NOT_ASSEMBLED;
    if (size <= pkm_step_tolerance) break;
  }
  if (!(size <= pkm_step_tolerance)) return PKM_NOT_ASSEMBLED;
  if (pkm_pose_differs(x, joints, &work)) return PKM_OTHER_MODE;
  if (command) {
    for (int i = 0; i < PKM_C; i++) c[i] = command[i];
    if (pkm_command_of(x, tool, c, &work) != PKM_OK) return PKM_NOT_ASSEMBLED;
    for (int i = 0; i < PKM_C; i++) command[i] = c[i];
  }
  for (int i = 0; i < PKM_X; i++) pose[i] = x[i];
  return PKM_OK;
}

void pkm_home(double *pose, double *joints, double *command) {
  for (int i = 0; i < PKM_X; i++) pose[i] = pkm_home_pose[i];
  for (int k = 0; k < PKM_Q; k++) joints[k] = pkm_home_joints[k];
  for (int i = 0; i < PKM_C; i++) command[i] = pkm_home_command[i];
}
