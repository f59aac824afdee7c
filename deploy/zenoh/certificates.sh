#!/bin/sh
# A small certificate authority for Zenoh over TLS: one folder, only openssl. Keep the folder on one computer, offline.
#
#   certificates.sh authority FOLDER NAME           begin it: FOLDER/authority.pem and its key
#   certificates.sh issue FOLDER NAME HOSTS [DAYS]  FOLDER/NAME.pem and NAME.key, valid 397 days unless DAYS says otherwise
#
# NAME becomes the common name, by which access rules know the holder: a machine's name, a person, a program. HOSTS are
# the addresses by which others connect to the holder, separated by commas (mill.plant.example,192.168.1.20); `localhost`
# and 127.0.0.1 are added. A reader that nobody connects to has none: give "".
set -eu
umask 077

usage() { sed -n '4,5s/^# *//p' "$0" >&2; exit 2; }

name_is_plain() {
    case $1 in
        ''|*[!A-Za-z0-9_.-]*) echo "NAME = '$1': expected letters, digits, _, . and -" >&2; exit 2 ;;
    esac
}

new_key() { openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1"; }

authority() {
    folder=$1 name=$2
    name_is_plain "$name"
    [ ! -e "$folder/authority.key" ] || { echo "$folder/authority.key exists; it is not overwritten" >&2; exit 1; }
    mkdir -p "$folder"
    new_key "$folder/authority.key"
    openssl req -x509 -new -key "$folder/authority.key" -days 3650 -subj "/CN=$name" -out "$folder/authority.pem" \
        -addext "basicConstraints=critical,CA:TRUE,pathlen:0" -addext "keyUsage=critical,keyCertSign,cRLSign"
}

issue() {
    folder=$1 name=$2 days=${4:-397} alternatives="DNS:localhost,IP:127.0.0.1"
    name_is_plain "$name"
    [ -e "$folder/authority.key" ] || { echo "$folder: no authority here; begin with: $0 authority" >&2; exit 1; }
    for host in $(echo "$3" | tr ',' ' '); do
        case $host in
            *:*) alternatives="$alternatives,IP:$host" ;;
            *[!0-9.]*) alternatives="$alternatives,DNS:$host" ;;
            *) alternatives="$alternatives,IP:$host" ;;
        esac
    done
    new_key "$folder/$name.key"
    request=$(mktemp) extensions=$(mktemp)
    trap 'rm -f "$request" "$extensions"' EXIT
    openssl req -new -key "$folder/$name.key" -subj "/CN=$name" -out "$request"
    cat > "$extensions" <<EOF
basicConstraints = critical, CA:FALSE
keyUsage = critical, digitalSignature
extendedKeyUsage = serverAuth, clientAuth
subjectAltName = $alternatives
EOF
    openssl x509 -req -in "$request" -CA "$folder/authority.pem" -CAkey "$folder/authority.key" -CAcreateserial \
        -days "$days" -extfile "$extensions" -out "$folder/$name.pem" 2>/dev/null
    chmod 644 "$folder/$name.pem" "$folder/authority.pem"
}

[ $# -ge 3 ] || usage
command=$1
shift
case $command in
    authority) [ $# -eq 2 ] || usage; authority "$@" ;;
    issue) [ $# -ge 3 ] && [ $# -le 4 ] || usage; issue "$@" ;;
    *) usage ;;
esac
