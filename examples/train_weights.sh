#!/usr/bin/env bash
# Trains every network that ships: this project's own, and the paper's with its two ablations.
#
#   examples/train_weights.sh OUT [--set KEY=VALUE ...]      all, three hours on H200s
#   ONLY="denoiser updater" examples/train_weights.sh OUT    some
#
# A run that is there already is continued, a finished one is left alone. Further arguments go to every `nsfc train`.
set -euo pipefail
out=${1:?"usage: examples/train_weights.sh OUT [--set KEY=VALUE ...]"}
shift
extra=("$@")
nsfc=${NSFC:-nsfc}
only=${ONLY:-denoiser updater no-denoiser no-gradient own-updater own-no-denoiser own-no-gradient direct-first direct-second direct-third direct-fourth direct-cameras direct-on direct family-first family-second family}
mkdir -p "$out"

# train NAME KIND TIME OPTIONS...
train() {
    local name=$1 kind=$2 time=$3
    shift 3
    case " $only " in *" $name "*) ;; *) return 0 ;; esac
    echo "== $name"
    if [ -e "$out/$name/config.resolved.yaml" ]; then
        $nsfc train "$kind" -o "$out/$name" --resume
    else
        $nsfc train "$kind" --fresh -o "$out/$name" --total-time "$time" "$@" ${extra[@]+"${extra[@]}"}
    fi
}

# What the paper's networks share: samples as in its section 2, kept in a pool of the last ones because a sample takes
# longer to simulate than to learn from; cosine decay, and an average of the weights, both within a fixed time.
paper=(--precision bf16 --set training.schedule=cosine --set training.warmup_steps=100 --set training.ema_decay=0.999
    --set training.clip_norm=1 --set training.patience=null --set training.steps_per_epoch=200
    --set training.exported=float16 --set training.replay.size=4096 --set training.replay.fresh_per_step=2)

train denoiser denoiser "${DENOISER_TIME:-300s}" --batch-size 8 "${paper[@]}"
denoiser=$out/denoiser/weights.safetensors
# Point-wise on perturbed reliefs, as in section 2.2; a target from a lattice, sharp as a capture is, costs next to nothing.
updater=(--batch-size 16 "${paper[@]}" --set training.replay.size=8192 --set training.clean.preset=lattice
    --set training.clean.n_photons=null)
with_denoiser=(--set "training.denoiser_weights=$denoiser")
without_gradient=(--preset paper-updater-no-gradient "${with_denoiser[@]}")
train updater updater "${UPDATER_TIME:-420s}" "${updater[@]}" "${with_denoiser[@]}"
train no-denoiser updater "${UPDATER_TIME:-420s}" "${updater[@]}"
train no-gradient updater "${UPDATER_TIME:-420s}" "${updater[@]}" "${without_gradient[@]}"
# And on, from their own answers and from flat: these ship.
own=("${updater[@]}" --seed 1 --set training.learning_rate=0.0025 --set training.replay.own_share=0.7
    --set training.replay.flat_share=0.5 --set training.validation.count=32 --set training.steps_per_epoch=500)
for name in updater no-denoiser no-gradient; do
    more=()
    [ $name = updater ] && more=("${with_denoiser[@]}")
    [ $name = no-gradient ] && more=("${without_gradient[@]}")
    train own-$name updater "${OWN_TIME:-500s}" "${own[@]}" ${more[@]+"${more[@]}"} \
        --initial-weights "$out/$name/weights.safetensors"
done

# This project's network: from the beginning, then three times from there with other samples, all on perfect images of
# one kind of print; and three times more through cameras and on prints that vary, on all GPUs. DEVICES tells how many.
ours=(--batch-size 64 --precision bf16 --set training.replay.size=12288 --set training.replay.fresh_per_step=32
    --set training.compile=true --set training.patience=null --set training.exported=float16)
again=("${ours[@]}" --set training.learning_rate=6e-4)
plain=(--set training.camera.clean_share=1 --set reliefs.variety=null)
train direct-first direct "${DIRECT_TIME:-1020s}" "${ours[@]}" "${plain[@]}"
train direct-second direct "${DIRECT_SECOND_TIME:-500s}" --seed 1 "${again[@]}" "${plain[@]}" \
    --initial-weights "$out/direct-first/weights.safetensors"
train direct-third direct "${DIRECT_THIRD_TIME:-450s}" --seed 2 "${again[@]}" "${plain[@]}" \
    --initial-weights "$out/direct-second/weights.safetensors"
train direct-fourth direct "${DIRECT_FOURTH_TIME:-500s}" --seed 3 "${again[@]}" "${plain[@]}" \
    --initial-weights "$out/direct-third/weights.safetensors"
train direct-cameras direct "${DIRECT_CAMERA_TIME:-490s}" --seed 4 --devices "${DEVICES:-1}" "${ours[@]}" \
    --set training.learning_rate=5e-4 --initial-weights "$out/direct-fourth/weights.safetensors"
on=("${ours[@]}" --set training.learning_rate=7e-4 --set training.ema_decay=0.9995)
train direct-on direct "${DIRECT_TIME_ON:-1065s}" --seed 6 --devices "${DEVICES:-1}" "${on[@]}" \
    --initial-weights "$out/direct-cameras/weights.safetensors"
train direct direct "${DIRECT_LAST_TIME:-1050s}" --seed 7 --devices "${DEVICES:-1}" "${on[@]}" \
    --initial-weights "$out/direct-on/weights.safetensors"

# The same told of its bench: any of a family, through any camera, in three legs, the last with feedback. Rounded to
# bytes at last.
told=("${on[@]}" --config family --set training.replay.size=16384 --set training.replay.fresh_per_step=8
    --set training.steps_per_epoch=1000)
train family-first direct "${FAMILY_TIME:-1190s}" --seed 12 --devices "${DEVICES:-1}" "${told[@]}" \
    --set network.feedback=false \
    --initial-weights "$out/direct/weights.safetensors"
train family-second direct "${FAMILY_SECOND_TIME:-1180s}" --seed 17 --devices "${DEVICES:-1}" "${told[@]}" \
    --set network.feedback=false --initial-weights "$out/family-first/weights.safetensors"
train family direct "${FAMILY_LAST_TIME:-1020s}" --seed 19 --devices "${DEVICES:-1}" "${told[@]}" \
    --set training.exported=int8 --initial-weights "$out/family-second/weights.safetensors"
