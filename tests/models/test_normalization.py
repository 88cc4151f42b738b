"""Running statistics of observations: one count for each feature, and files that have one for all."""

from __future__ import annotations

import torch

from skatemount.models.normalization import RunningNormalizer


def observed(batches: list[torch.Tensor]) -> RunningNormalizer:
    normalizer = RunningNormalizer(batches[0].shape[-1])
    for batch in batches:
        normalizer.observe(batch)
    return normalizer


def test_features_that_were_added_start_from_their_first_batch() -> None:
    generator = torch.Generator().manual_seed(0)
    first = torch.randn(50, 2, generator=generator) * 3 + 1
    later = torch.randn(30, 3, generator=generator) * 2 - 5
    wide = RunningNormalizer(3)
    wide.inherit(observed([first]), torch.tensor([2, 0]))
    assert wide.count.tolist() == [50, 0, 50]
    wide.observe(later)
    assert wide.count.tolist() == [80, 30, 80]
    torch.testing.assert_close(wide.mean[1], later[:, 1].mean())
    torch.testing.assert_close(wide.var[1], later[:, 1].var(correction=0))
    everything = torch.cat((first, later[:, [2, 0]]))
    torch.testing.assert_close(wide.mean[[2, 0]], everything.mean(0))
    torch.testing.assert_close(wide.var[[2, 0]], everything.var(0, correction=0))


def test_one_count_for_all_features_is_read_and_goes_on_the_same() -> None:
    batches = [torch.randn(20, 4, generator=torch.Generator().manual_seed(i)) for i in range(3)]
    new = observed(batches[:2])
    saved = new.state_dict() | {"count": torch.tensor(40.0, dtype=torch.float64)}
    old = RunningNormalizer(4)
    old.load_state_dict(saved)
    assert saved["count"].ndim == 0  # what was given stays as it was
    for each in (new, old):
        each.observe(batches[2])
    assert all(torch.equal(a, b) for a, b in zip(new.state_dict().values(), old.state_dict().values()))
