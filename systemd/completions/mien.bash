# bash completion for mien
_mien() {
  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}
  case $before in
    --config | --model | --csv) COMPREPLY=($(compgen -f -- "$word")); return ;;
    --source) COMPREPLY=($(compgen -d -W 'auto kinect depth-camera camera simulated -' -- "$word") $(compgen -f -X '!*.y4m' -- "$word")); return ;;
    --frames) return ;;
  esac
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W 'run check-config print-config devices doctor bench send-test help --help --version' -- "$word"))
    return
  fi
  case ${COMP_WORDS[1]} in
    run) COMPREPLY=($(compgen -W '--config --source --csv --frames --fast --model --require-device --quiet --verbose' -- "$word")) ;;
    bench) COMPREPLY=($(compgen -W '--config --source --frames' -- "$word")) ;;
    print-config | doctor | send-test) COMPREPLY=($(compgen -W '--config' -- "$word")) ;;
    check-config) COMPREPLY=($(compgen -f -- "$word")) ;;
  esac
}
complete -o filenames -F _mien mien
