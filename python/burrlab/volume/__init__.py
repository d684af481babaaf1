"""Volumes from files, grey or labelled, and bone made of them."""

    "load_drilled",
