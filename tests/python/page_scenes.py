"""A page without a server and without a renderer, for quick tests."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from burrlab.view.page import Page


class State(dict):
    """As trame's: attributes, and callables that are told of changes."""

    def __init__(self):
        super().__init__()
        self.__dict__["calls"] = {}

    __getattr__ = dict.__getitem__
    __setattr__ = dict.__setitem__

    def change(self, name):
        return lambda call: self.calls.setdefault(name, call)

    def tell(self, name, value):
        """As if a browser had changed it."""
        self[name] = value
        self.calls[name](**self)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class Server:
    def __init__(self):
        self.state, self.triggers = State(), {}

    def trigger(self, name):
        return lambda call: self.triggers.setdefault(name, call)


class Camera(SimpleNamespace):
    def Azimuth(self, angle):  # VTK's names
        self.turned[0] += angle

    def Elevation(self, angle):
        self.turned[1] += angle

    def OrthogonalizeViewUp(self):
        pass

    def Dolly(self, factor):
        self.nearer *= factor


class Scene:
    """Notes what it is asked for; its pictures are grey."""

    def __init__(self, bone, radii):
        camera = Camera(
            position=(0.0, 0.0, 50.0), focal_point=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), view_angle=30.0,
            turned=[0.0, 0.0], nearer=1.0,
        )  # fmt: skip
        nothing = SimpleNamespace(SetMultiSamples=lambda n: None)
        self.smooth = None
        renderer = SimpleNamespace(
            UseFXAAOn=lambda: setattr(self, "smooth", True), UseFXAAOff=lambda: setattr(self, "smooth", False)
        )
        self.plotter = SimpleNamespace(
            camera=camera, render_window=nothing, renderer=renderer, window_size=[1024, 768]
        )
        self.actors = SimpleNamespace(property=SimpleNamespace(BackfaceCullingOn=lambda: None))
        self.updated, self.pictures, self.looked, self.cuts, self.parcels = [], 0, [], [], None

    def look(self, viewpoint):
        self.looked.append(viewpoint)

    def update(self, bone, bricks=None):
        self.updated.append(np.asarray(bricks))

    def move_burrs(self, centers, on):
        self.centers, self.on = centers, on

    def set_parcels(self, parcels):
        self.parcels = parcels

    def set_slices(self, point):
        self.cuts.append(point)

    def picture(self):
        self.pictures += 1
        return np.full((8, 8, 3), 128, np.uint8)


def make_page(source):
    return Page(Server(), source, Scene(source.bone, source.radii))
