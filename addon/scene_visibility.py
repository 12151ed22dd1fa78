"""Which of the things that the viewport shows, a render shows too.

The evaluated depsgraph is the viewport's: it has what is disabled in renders, and lacks what is
hidden in the viewport.  These are the rules that Blender follows when it builds a render's.
"""

from collections.abc import Iterator

import bpy


def scene_objects(view_layer: bpy.types.ViewLayer) -> set[bpy.types.Object]:
    """The objects that a render of ``view_layer`` may show."""
    return set(_of_layer(view_layer.layer_collection))


def _of_layer(layer: bpy.types.LayerCollection) -> Iterator[bpy.types.Object]:
    if layer.exclude or layer.collection.hide_render:
        return
    yield from (obj for obj in layer.collection.objects if not obj.hide_render)
    for child in layer.children:
        yield from _of_layer(child)


def hidden_members(collection: bpy.types.Collection) -> set[bpy.types.Object]:
    """What an instance of ``collection`` holds, nested instances included, and a render hides."""
    return set(_members(collection, every=True)) - set(_members(collection, every=False))


def _members(collection: bpy.types.Collection, every: bool) -> Iterator[bpy.types.Object]:
    if collection.hide_render and not every:
        return
    for obj in collection.objects:
        if obj.hide_render and not every:
            continue
        yield obj
        if obj.instance_collection:
            yield from _members(obj.instance_collection, every)
    for child in collection.children:
        yield from _members(child, every)


class Rendered:
    """Answers for the instances of one depsgraph whether a render shows them and their shadow."""

    def __init__(self, view_layer: bpy.types.ViewLayer) -> None:
        self._objects = scene_objects(view_layer)
        self._hidden: dict[str, set[bpy.types.Object]] = {}

    def casts_shadow(self, instance: bpy.types.DepsgraphObjectInstance) -> bool:
        """Whether ``instance`` is rendered and stops light.

        What geometry nodes and particles instance is rendered even if the object itself is not:
        that is how an artist hides the original of a scattered thing.
        """
        obj = instance.object.original
        if not instance.object.visible_shadow:
            return False
        if not instance.is_instance:
            return instance.show_self and obj in self._objects and not _hides_itself(obj)
        parent = instance.parent.original
        if parent not in self._objects or not parent.visible_shadow:
            return False
        if parent.instance_type == "COLLECTION" and parent.instance_collection:
            return obj not in self._hidden_in(parent.instance_collection)
        return parent.instance_type == "NONE" or not obj.hide_render

    def _hidden_in(self, collection: bpy.types.Collection) -> set[bpy.types.Object]:
        if collection.name_full not in self._hidden:
            self._hidden[collection.name_full] = hidden_members(collection)
        return self._hidden[collection.name_full]


def _hides_itself(obj: bpy.types.Object) -> bool:
    """Whether a render shows only the instances that ``obj`` makes, or that are made of it."""
    if obj.parent and obj.parent.instance_type in {"VERTS", "FACES"}:
        return True
    instances = obj.is_instancer or len(obj.particle_systems) > 0
    return instances and not obj.show_instancer_for_render
