"""Simulated machine-vision cameras that speak the real protocols and render frames that depend on exposure."""
