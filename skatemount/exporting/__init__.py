"""Export of a trained policy: ONNX graphs, a card, scenes and start states that need neither torch nor this package."""
