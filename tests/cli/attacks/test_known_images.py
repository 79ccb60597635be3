"""Which image a verdict is of: the content decides, not name, size and time."""

import hashlib
import os
import time


def test_an_image_of_the_same_time_is_another_image(tmp_path):
    """Name, size and time are equal, as after `cp -p`: the content decides."""
    from cli.inspection.plates import Plates

    image = tmp_path / "a.tif"
    image.write_bytes(b"good")
    os.utime(image, (1e9, 1e9))
    plates = Plates(tmp_path, "settings")
    sha256 = hashlib.sha256(b"good").hexdigest()
    row = {"image": "a.tif", "exit_code": "0", "modified": "2001-09-09T01:46:40.000000000Z", "sha256": sha256}
    plates.add(str(image), row)
    assert plates.is_done(str(image))
    image.write_bytes(b"bad!")
    os.utime(image, (1e9, 1e9))
    assert not plates.is_done(str(image))
    plates.add(str(image), {**row, "sha256": ""})
    assert not plates.is_done(str(image))


def test_a_watched_folder_sees_an_image_of_the_same_time(tmp_path):
    from cli.inspection.watch import Watcher

    image = tmp_path / "a.tif"
    watcher = Watcher(str(tmp_path), lambda path: False)
    for content in (b"good", b"bad!"):
        image.write_bytes(content)
        os.utime(image, (1e9, 1e9))
        assert watcher.look() == []
        assert watcher.look() == [str(image)]
        time.sleep(0.02)  # the file system's clock ticks
