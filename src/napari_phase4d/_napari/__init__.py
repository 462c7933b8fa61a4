"""The napari plugin: the only room that imports Qt, magicgui or napari."""
