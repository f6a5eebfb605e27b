"""ORB features (Rublee et al., ICCV 2011), matched one by one with Lowe's ratio test."""

from __future__ import annotations

from hashlib import blake2b

import cv2
import numpy as np

from ..errors import ImageError

DESCRIPTOR_BYTES = 32
EDGE_PX = 31  # nearer to the border, a feature has no whole neighbourhood
# About 60 MB. Full, it is emptied: a flight of a thousand view cells has half a million pairs.
MEMO_PAIRS = 500_000


class RatioTest:
    """
    s_ij = 1 - N_m / max_m, as the paper prints it: a distance.

    N_m is the number of features of the query whose nearest feature of the other is clearly
    nearer than the second nearest, by Hamming distance. The paper does not say how many matches
    are possible; here max_m is the larger number of features of the two: by the smaller one, a
    view of few features would be like any other.

    A pair takes a quarter of a millisecond, and tuning mu asks for the same pairs again and
    again: they are remembered.

    Parameters
    ----------
    ratio : float
        Largest ratio of the distances to the nearest and the second nearest feature.

    """

    direction = -1
    worst = 1.0

    def __init__(self, ratio: float):
        self._ratio = ratio
        self._memo: dict[int, dict[int, float]] = {}
        self._n_known = 0

    def prepare(self, descriptor: np.ndarray) -> np.ndarray:
        """Return the features (n_features, 32), uint8, and their digest in one more row."""
        digest = blake2b(descriptor.tobytes(), digest_size=DESCRIPTOR_BYTES).digest()
        return np.vstack([descriptor, np.frombuffer(digest, np.uint8)])

    def compare(self, query: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the distances (n,), in [0, 1], of what is kept of one frame with n others."""
        if self._n_known + len(kept) > MEMO_PAIRS:
            self._memo.clear()
            self._n_known = 0
        known = self._memo.setdefault(_digests(query[None])[0], {})
        self._n_known -= len(known)
        ours = _features(query)
        digests = _digests(kept)
        for digest, other in zip(digests, kept):
            if digest not in known:
                known[digest] = self._distance(ours, _features(other))
        self._n_known += len(known)
        return np.array([known[digest] for digest in digests], np.float32)

    def _distance(self, query: np.ndarray, other: np.ndarray) -> float:
        if len(query) == 0 or len(other) < 2:
            return self.worst
        hamming, _ = cv2.batchDistance(
            query, other, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
        matches = np.count_nonzero(hamming[:, 0] < self._ratio * hamming[:, 1])
        return 1.0 - matches / max(len(query), len(other))


def _digests(kept: np.ndarray) -> list[int]:
    return np.ascontiguousarray(kept[:, -1, :8]).view(np.uint64).ravel().tolist()


def _features(kept: np.ndarray) -> np.ndarray:
    """Return the features that are there, without the digest."""
    return kept[:-1][kept[:-1].any(axis=1)]


class Orb:
    """
    The descriptors of the strongest corners of the image.

    Parameters
    ----------
    n_features : int
        Most features of a frame.
    ratio : float
        See `RatioTest`.

    """

    def __init__(self, n_features: int = 200, ratio: float = 0.75):
        self.measure = RatioTest(ratio)
        self._n_features = n_features
        self._orb = cv2.ORB_create(nfeatures=n_features, edgeThreshold=EDGE_PX)

    def describe(self, grey: np.ndarray) -> np.ndarray:
        """
        Return the features of a grey image (rows, columns), uint8.

        Returns
        -------
        ndarray of shape (n_features, 32), uint8
            The rows of features that were not found are zero.

        Raises
        ------
        ImageError
            When the image is not two-dimensional uint8.

        """
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise ImageError(
                f'expected a grey uint8 image, got {grey.dtype} of shape {grey.shape}')
        features = np.zeros((self._n_features, DESCRIPTOR_BYTES), np.uint8)
        if min(grey.shape) <= 2 * EDGE_PX:  # OpenCV fails on the smallest of them
            return features
        found = self._orb.detectAndCompute(grey, None)[1]
        if found is not None:
            features[:len(found)] = found[:self._n_features]
        return features
