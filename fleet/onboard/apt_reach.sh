#!/bin/sh
# Check within seconds that one of this system's package archives answers; without a network apt itself needs minutes.
#
# One archive that answers is enough. With a proxy nothing is checked: only the proxy knows what it can reach.

apt-config dump | grep -qE "^Acquire::https?::.*Proxy.* \".+\"" && exit 0
sites=$(apt-get --print-uris update 2>/dev/null | sort -u | sed -nE "s,^.http://([^][/:@]+)/.*,\1:80,p
  s,^.https://([^][/:@]+)/.*,\1:443,p; s,^.https?://([^][/:@]+:[0-9]+)/.*,\1,p" | uniq)
[ -n "$sites" ] || exit 0
for site in $sites; do
    host=${site%:*}
    timeout 10 getent ahosts "$host" >/dev/null || {
        problem="Could not resolve host: $host"
        continue
    }
    # shellcheck disable=SC2016 # the inner shell expands its own arguments
    timeout 10 bash -c ': > "/dev/tcp/$1/$2"' bash "$host" "${site##*:}" 2>/dev/null && exit 0
    problem="Could not connect to $host"
done
echo "$problem" >&2
exit 1
