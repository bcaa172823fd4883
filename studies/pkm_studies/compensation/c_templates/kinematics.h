#ifndef PKM_KINEMATICS_H
#define PKM_KINEMATICS_H

#ifdef __cplusplus
extern "C" {
#endif

/* Results of the functions. */
enum { PKM_OK = 0, PKM_NOT_ASSEMBLED = 1, PKM_OTHER_MODE = 2 };

/* Pose and joints that hold a command. `tool` is the tool point relative to the
   reference tool's, NULL for none; `pose` may be NULL. On failure nothing is written. */
int pkm_inverse(
    const double *command, const double *tool, double *pose, double *joints);

/* Pose and command at joints. Both hold a start nearby: the last ones, or those of
   pkm_home(). `command` may be NULL. On failure they stay as they are. */
int pkm_forward(
    const double *joints, const double *tool, double *pose, double *command);

/* The home pose of the machine. */
void pkm_home(double *pose, double *joints, double *command);

#ifdef __cplusplus
}
#endif

#endif
