/* LinuxCNC's entry points around it (LinuxCNC 2.9, uspace). */

#include "rtapi.h"
#include "rtapi_app.h"
#include "hal.h"
#include "kinematics.h"

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);
MODULE_LICENSE("GPL");

static int pkm_component;
static int pkm_started;
static double pkm_last_pose[PKM_X], pkm_last_command[PKM_C];

KINEMATICS_TYPE kinematicsType(void) { return KINEMATICS_BOTH; }

int kinematicsInverse(
    const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
    KINEMATICS_FORWARD_FLAGS *fflags) {
  double command[PKM_C], q[PKM_Q];
  (void)iflags;
  (void)fflags;
@COMMAND_OF_WORLD@
  if (pkm_inverse(command, NULL, NULL, q) != PKM_OK) return -1;
  for (int k = 0; k < PKM_Q; k++) joint[k] = q[k] / pkm_joint_unit[k];
  return 0;
}

int kinematicsForward(
    const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
    KINEMATICS_INVERSE_FLAGS *iflags) {
  double q[PKM_Q], home[PKM_Q];
  (void)fflags;
  (void)iflags;
  for (int k = 0; k < PKM_Q; k++) q[k] = joint[k] * pkm_joint_unit[k];
  if (!pkm_started || pkm_forward(q, NULL, pkm_last_pose, pkm_last_command) != PKM_OK) {
    pkm_home(pkm_last_pose, home, pkm_last_command);
    pkm_started = 1;
    if (pkm_forward(q, NULL, pkm_last_pose, pkm_last_command) != PKM_OK) return -1;
  }
@WORLD_OF_COMMAND@
  return 0;
}

int rtapi_app_main(void) {
  pkm_component = hal_init("@MODULE@");
  if (pkm_component < 0) return pkm_component;
  hal_ready(pkm_component);
  return 0;
}

void rtapi_app_exit(void) { hal_exit(pkm_component); }
