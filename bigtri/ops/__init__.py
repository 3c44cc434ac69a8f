"""The operations on tensors: one public function a file. Nothing here knows scenes or files."""

from . import fakes as fakes  # registers what torch.compile needs before any operator runs
