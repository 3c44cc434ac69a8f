"""The operations on tensors: one public function a file. Nothing here knows scenes or files."""
