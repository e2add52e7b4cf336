"""A metric: the median error of hands, in reports after cabinpose's own."""

from collections.abc import Iterable

import numpy as np

from cabinpose.evaluate import Metric, Number, SampleView


def _median_of_hands(view: SampleView) -> Iterable[Number]:
    hands = np.isin(view.samples.skeleton.joints, ("lhand", "rhand"))
    errors = np.where(hands, view.found_errors, np.nan)
    return view.quantiles(errors, {"median error of hands": 0.5}, "hands that were found")


HANDS = Metric("median error of hands", "{length}", "less", _median_of_hands, spaces=("3d",))
