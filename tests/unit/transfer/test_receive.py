from __future__ import annotations

from fleet import onboard
from fleet.plan.step import Upload, UploadBatch
from fleet.transfer import load_archive, receive
from fleet.transfer.load_archive import BLOCK, INCOMING
from fleet.transfer.receive import STALE, TransferRun
from tests.support.handmade import Handmade, layer, packed

BASE, CODE = layer(1), layer(2)
TALKER = Handmade(layers=(BASE, CODE))
BLOBS = {blob.diff_id: blob for blob, _ in map(packed, (BASE, CODE))}


def test_the_step_names_what_is_received_and_can_be_repeated() -> None:
    """It touches nothing that runs, its time depends on the link, and a name with blanks becomes one word."""
    skeleton = load_archive.skeleton([TALKER.wanted], blobs=BLOBS, sent=list(BLOBS.values()))
    batch = UploadBatch(label="1 of 2 layers", to="pi1", pieces=(Upload(digest="d", size=5),))
    run = TransferRun(to="pi1", token="one", by="tim b@desktop")  # noqa: S106  of a run
    step = receive.step(batch, skeleton, tuple(BLOBS.values()), {}, title="send 1 of 2 layers", run=run)
    (manifest,) = skeleton.manifests
    named = f"{manifest.image.incoming} {manifest.image.fingerprint} {manifest.image.name}"
    assert (step.title, step.feed) == ("send 1 of 2 layers", batch)
    assert (step.limit, step.harmless, step.resumes) == (None, True, True)
    assert step.argv == (
        *("sh", "-c", onboard.text("receive.sh"), "receive"),
        *("one", "tim_b@desktop", skeleton.hex, INCOMING, str(STALE), "upload d 5"),
        *(f"layer {blob.hex} {blob.size} cat" for blob in BLOBS.values()),
        f"image {named} {manifest.ids[0]} {manifest.ids[1]} {manifest.offset} {manifest.length}",
    )


def test_the_script_pads_to_the_blocks_of_the_archive() -> None:
    """The script has the size of a block as a number of its own."""
    assert f"\nblock={BLOCK} " in onboard.text("receive.sh")
