"""rlco's own renderer: a rasteriser in compiled loops, without the GIL or OpenGL."""

from rlco.physics.rendering.raster.camera import Channels, RasterCamera

__all__ = ["Channels", "RasterCamera"]
