"""Films of recordings with the look of the page of `sandgait replay --html`: meshes, shadows, footprints, arrows."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image

from sandgait import server

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "tests/browser"))

from chromium import Page  # type: ignore[import-not-found]  # noqa: E402

#: The scene alone, as large as the window.
ALONE = """(() => { const style = document.createElement('style');
style.textContent = '#layers, #scale, #readout, header, footer { display: none !important; } '
  + '#stage { position: fixed !important; inset: 0; z-index: 9; } '
  + '#world { width: 100vw !important; height: 100vh !important; }';
document.head.append(style); player.play(false); })()"""
#: Moves the camera along its view, from its own distance to a share of it.
NEARER = """(() => { const { camera, controls } = player.world;
camera.position.sub(controls.target).multiplyScalar(%f).add(controls.target); })()"""
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))))"


def film(
    recording: Path,
    out: Path,
    times: Sequence[float],
    *,
    size: tuple[int, int] = (640, 360),
    nearer: float = 0.6,
    draw: Callable[[Image.Image, int], None] = lambda picture, k: None,
) -> None:
    """Writes a film (webp) of the moments at `times` [s], which are equally far apart; `draw` adds to each picture."""
    with tempfile.TemporaryDirectory() as folder:
        html = Path(folder) / "film.html"
        command = [*server.command(), "replay", str(recording), "--html", str(html)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        page = Page(Path(folder) / "profile")
        width, height = size
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        page.open(html.as_uri())
        page.until("player.world?.pose !== undefined && player.world.pose !== null")
        page.ask(ALONE)
        page.ask(f"player.time = {times[0]}")
        page.ask(DRAWN)
        page.ask(NEARER % nearer)
        frames = []
        for k, time in enumerate(times):
            page.ask(f"player.time = {time + 1e-4}")
            page.ask(DRAWN)
            shot = Path(folder) / "frame.png"
            page.picture(shot)
            frames.append(Image.open(io.BytesIO(shot.read_bytes())).convert("RGB"))
            draw(frames[-1], k)
        page.close()
    pause = round(1000 * (times[1] - times[0]))
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=pause, loop=0, quality=55, method=6)
    print(f"{out.name}: {len(frames)} frames, {out.stat().st_size // 1024} KiB")
