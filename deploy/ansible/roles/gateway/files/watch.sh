#!/bin/sh
# watch.sh SECONDS WELL: fails as soon as the gateway has ended by itself, and if WELL is 1 and it is not well within a
# minute after these seconds. Prints why.
config=/etc/talc-gateway/gateway.toml
left_s=$1
restarts() { systemctl show --property=NRestarts --value talc-gateway; }
before=$(restarts)
while :; do
    if ! systemctl is-active --quiet talc-gateway || [ "$(restarts)" != "$before" ]; then
        echo "the gateway ended by itself"
        exit 1
    fi
    if [ "$left_s" -le 0 ]; then
        [ "$2" = 1 ] || exit 0
        if said=$(talc-gateway status "$config" 2>&1); then exit 0; fi
        [ "$left_s" -gt -60 ] || { echo "$said"; exit 1; }
    fi
    sleep 5
    left_s=$((left_s - 5))
done
