#!/bin/sh
# check_dependencies.sh [FOLDER]: the house's dependency rule, read off the #include lines of FOLDER (default: this
# checkout). Prints every include that breaks it and exits 1; lists files past 800 lines without failing.
# check_dependencies.sh --self-test: shows that it sees what it should see.
set -eu

# One line per module: its folder, then the folders it may include from beside itself. "core" means all of core.
rules='
core/status.
shaders/shared
shaders
core/gpu       core/status.
core/image     core/status.
core/measure   core/status.
core/scene     core/status. core/image shaders/shared
core/render    core/status. core/gpu core/scene shaders
protocol       core/status.
server         core protocol shaders/shared
clients        core/status. core/measure core/image protocol
bench          core protocol clients shaders
'

check() { # check FOLDER
    (
        cd "$1"
        for folder in core shaders protocol server clients bench; do
            [ ! -d "$folder" ] || find "$folder" -type f \( -name '*.c' -o -name '*.h' -o -name '*.cpp' -o -name '*.hpp' \)
        done | sort | awk -v rules="$rules" '
            function starts(path, folder) {
                return substr(path, 1, length(folder)) == folder &&
                    (folder ~ /\.$/ || substr(path, length(folder) + 1, 1) == "/")
            }
            function module(path,    i, best) { # the longest folder of the rules that holds it
                best = ""
                for (i = 1; i <= count; i++)
                    if (starts(path, folder[i]) && length(folder[i]) > length(best)) best = folder[i]
                return best
            }
            function normal(path,    parts, kept, n, i, top) {
                n = split(path, parts, "/"); top = 0
                for (i = 1; i <= n; i++) {
                    if (parts[i] == "." || parts[i] == "") continue
                    if (parts[i] == ".." && top > 0) { top--; continue }
                    kept[++top] = parts[i]
                }
                path = ""
                for (i = 1; i <= top; i++) path = path (i > 1 ? "/" : "") kept[i]
                return path
            }
            function exists(path,    line, found) {
                found = (getline line < path) >= 0
                close(path)
                return found
            }
            BEGIN {
                lines = split(rules, text, "\n")
                for (i = 1; i <= lines; i++) {
                    fields = split(text[i], field, " ")
                    if (!fields) continue
                    folder[++count] = field[1]
                    may[field[1]] = " "
                    for (j = 2; j <= fields; j++) may[field[1]] = may[field[1]] field[j] " "
                }
            }
            {
                file = $0; here = file; sub(/[^\/]*$/, "", here); own = module(file); number = 0
                while ((getline line < file) > 0) {
                    number++
                    if (line !~ /^[ \t]*#[ \t]*include[ \t]*"/) continue
                    name = line; sub(/^[^"]*"/, "", name); sub(/".*/, "", name)
                    target = normal(here name)
                    if (!exists(target)) target = normal(name)
                    other = module(target)
                    if (other == "" || other == own) continue # a library, a generated file, or its own module
                    allowed = 0
                    n = split(may[own], field, " ")
                    for (i = 1; i <= n; i++)
                        if (other == field[i] || starts(other, field[i])) allowed = 1
                    if (!allowed) {
                        printf "%s:%d: %s may not include %s (%s)\n", file, number, own, other, name
                        broken++
                    }
                }
                close(file)
                if (number > 800) printf "%s: %d lines; is it one thing?\n", file, number
            }
            END {
                if (broken) { printf "%d includes break the dependency rule\n", broken; exit 1 }
                printf "dependency rule: %d files keep it\n", NR
            }'
    )
}

self_test() {
    tree=$(mktemp -d)
    trap 'rm -rf "$tree"' EXIT
    mkdir -p "$tree/core/gpu" "$tree/core/scene" "$tree/core/render" "$tree/core/measure" "$tree/core/image" \
        "$tree/protocol" "$tree/server" "$tree/clients/lib" "$tree/shaders/shared"
    for header in core/status core/gpu/gpu core/scene/scene core/render/renderer core/measure/analytic core/image/image \
        protocol/protocol server/server clients/lib/client shaders/shared/shared shaders/shader_table; do
        : >"$tree/$header.h"
    done
    expect() { # expect keeps|breaks FILE INCLUDE
        printf '#include <stdio.h>\n#include "%s"\n' "$3" >"$tree/$2"
        if check "$tree" >/dev/null; then result=keeps; else result=breaks; fi
        rm "$tree/$2"
        if [ "$result" != "$1" ]; then
            echo "self-test: $2 including $3 $result the rule, expected: $1"
            exit 1
        fi
    }
    expect keeps core/render/a.c ../gpu/gpu.h
    expect keeps core/render/a.c core/scene/scene.h
    expect keeps core/render/a.c shaders/shader_table.h
    expect keeps core/render/a.c ../../shaders/shared/shared.h
    expect keeps core/scene/a.c ../image/image.h
    expect keeps core/gpu/a.c ../status.h
    expect keeps core/gpu/a.c volk.h
    expect keeps server/a.c ../core/render/renderer.h
    expect keeps server/a.c protocol/protocol.h
    expect keeps clients/lib/a.c ../../protocol/protocol.h
    expect keeps clients/lib/a.c client.h
    expect keeps clients/lib/a.c core/measure/analytic.h
    expect breaks core/gpu/a.c ../scene/scene.h
    expect breaks core/scene/a.c core/gpu/gpu.h
    expect breaks core/measure/a.c ../image/image.h
    expect breaks core/measure/a.c core/render/renderer.h
    expect breaks core/image/a.c ../scene/scene.h
    expect breaks core/render/a.c ../measure/analytic.h
    expect breaks core/render/a.c ../../protocol/protocol.h
    expect breaks protocol/a.c ../core/gpu/gpu.h
    expect breaks protocol/a.c core/render/renderer.h
    expect breaks server/a.c ../clients/lib/client.h
    expect breaks clients/lib/a.c core/render/renderer.h
    expect breaks clients/lib/a.c ../../server/server.h
    expect breaks clients/lib/a.c ../../core/gpu/gpu.h
    echo "dependency rule: the self-test's 12 sound and 13 unsound includes were told apart"
}

case "${1-}" in
--self-test) self_test ;;
*) check "${1:-$(dirname "$0")/..}" ;;
esac
