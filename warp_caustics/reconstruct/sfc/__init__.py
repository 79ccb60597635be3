"""SfC: shape from caustics by thresholded Landweber iterations."""
