#!/bin/bash
# A take encoded as a Slurm array, one task for each segment; run it where sbatch is:
#
#     slurm.sh RIG WORK LAST_SEGMENT FRAMES_PER_SEGMENT OPTIONS...
#     slurm.sh /data/take /data/out 19 30 --preset standard --threads 4
#
# The machines share the folders RIG and WORK, and have the same release of decogs on their PATH. WORK/scene.dgs is the
# stream. A task that ends with 75 may be tried again, so it is put back into the queue.
set -eu
rig=$1 work=$2 last=$3 segment=$4
# A shell runs what stands in a number's place.
if [[ ! $last =~ ^(0|[1-9][0-9]*)$ || ! $segment =~ ^[1-9][0-9]*$ ]]; then
    echo "slurm.sh: LAST_SEGMENT and FRAMES_PER_SEGMENT are numbers, not $last and $segment" >&2
    exit 2
fi

encode() {
    local code=0
    decogs-encode --segment "$segment" --closed "$@" -- "$rig" || code=$?
    if [ $code = 75 ]; then scontrol requeue "$SLURM_JOB_ID"; fi
    exit $code
}

case ${STEP:-submit} in
submit)
    mkdir -p -- "$work/parts"
    keyframe=$(sbatch --parsable --requeue --export=ALL,STEP=keyframe "$0" "$@")
    parts=$(sbatch --parsable --requeue --export=ALL,STEP=part --array="0-$last" --dependency="afterok:$keyframe" "$0" "$@")
    sbatch --parsable --export=ALL,STEP=join --dependency="afterok:$parts" "$0" "$@"
    ;;
keyframe)
    encode --output="$work/key.dgs" --only 0:1 "${@:5}"
    ;;
part)
    first=$((SLURM_ARRAY_TASK_ID * segment))
    encode --output="$work/parts/$first.dgs" --keyframe="$work/key.dgs" --only "$first:$((first + segment))" "${@:5}"
    ;;
join)
    exec decogs-join --output="$work/scene.dgs" -- "$work"/parts/*.dgs
    ;;
esac
