"""An atlas on disk: manifest, cells, locks."""
