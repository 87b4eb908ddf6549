"""sRGB and linear light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def linear(encoded: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Linear light of sRGB values, 0 to 1 (IEC 61966-2-1)."""
    values = encoded.astype(np.float64)
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4)


def srgb(light: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Linear light, brought to 0 to 1 first, as sRGB values."""
    values = np.clip(light.astype(np.float64), 0.0, 1.0)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)
