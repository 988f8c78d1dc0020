#include "folder.h"

#include <errno.h>
#include <string.h>
#include <sys/stat.h>

bool folder_make(const char *folder, struct error *error)
{
    char path[4000];
    if (!*folder || strlen(folder) >= sizeof path)
        return error_set(error, STATUS_INVALID, "\"%.100s\": %s", folder,
                         *folder ? "the name is too long" : "a folder needs a name");
    memcpy(path, folder, strlen(folder) + 1);
    for (char *at = path + 1;; at++) {
        if (*at && *at != '/')
            continue;
        char end = *at;
        *at = 0;
        if (mkdir(path, 0777) < 0 && errno != EEXIST)
            return error_set(error, STATUS_IO, "%.300s: %s", path, strerror(errno));
        *at = end;
        if (!end)
            break;
    }
    struct stat status;
    if (stat(path, &status) < 0 || !S_ISDIR(status.st_mode))
        return error_set(error, STATUS_IO, "%.300s: is no folder", path);
    return true;
}
