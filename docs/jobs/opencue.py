"""A take on OpenCue, by PyOutline: the keyframe, the parts, the join. Written from OpenCue's documentation, never run.

OpenCue's frames are the take's frames (here 600), its chunks are parts (here two segments of 30 frames). #FRAME_START#
and #FRAME_END# are a chunk's first and last frame. Make /data/out/parts first. A shell runs these lines: put names with
blanks or signs through `shlex.quote`.
"""

import outline
from outline.modules.shell import Shell

encode = "decogs-encode /data/take --segment 30 --closed --preset high --threads 4"
job = outline.Outline("take")
key = Shell("keyframe", command=[f"{encode} -o /data/out/key.dgs --only 0:1"], range="0", threads=4)
to_part = f"{encode} --keyframe /data/out/key.dgs -o /data/out/parts/#FRAME_START#.dgs"
part = f"{to_part} --only #FRAME_START#:$((#FRAME_END# + 1))"
parts = Shell("parts", command=["bash", "-c", part], range="0-599", chunk=60, threads=4)
join = Shell("join", command=["bash -c 'decogs-join /data/out/parts/*.dgs -o /data/out/scene.dgs'"], range="0")
parts.depend_all(key)
join.depend_all(parts)
for layer in (key, parts, join):
    job.add_layer(layer)
outline.cuerun.launch(job)
