"""Random models of the real classes, to try loading, training and saving.

A few hundred thousand random weights each, written in the real ones' file formats: no
download, no accelerator, nothing that they know.
"""
