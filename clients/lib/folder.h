/* folder.h: where a program puts its files. */
#ifndef CAUSTIC_FOLDER_H
#define CAUSTIC_FOLDER_H

#include "../../core/status.h"

/* Makes `folder` and those it lies in, where they are missing. Errors name the part that failed. */
bool folder_make(const char *folder, struct error *error);

#endif
