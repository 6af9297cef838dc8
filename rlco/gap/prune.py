"""A spec that is compiled again and again: the same motion, in about a millisecond."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
_WRAPS_GEOM = (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)


@dataclass(frozen=True)
class Whole:
    """A spec and what it compiles to, element for element.

    Attributes:
        spec: The spec, not compiled: only such a one forgets materials.
        compiled: A copy that was, whose elements have their numbers.
        model: What it compiled to.
    """

    spec: mujoco.MjSpec
    compiled: mujoco.MjSpec
    model: mujoco.MjModel


def compile_whole(spec: mujoco.MjSpec) -> Whole:
    """Compile a copy of a spec of which nothing is fused or discarded.

    Where a model asks for it, as every URDF does, links on fixed joints become one
    with their parents and geoms that are only shown go; either leaves elements without
    their compiled counterpart, and MuJoCo 3.9 misplaces the centre of mass of what it
    fuses where a frame of inertia is turned (its pull request 3250).

    Raises:
        ValueError: MuJoCo's, where the spec does not compile.
    """
    whole = spec.copy()
    whole.compiler.fusestatic = whole.compiler.discardvisual = False
    compiled = whole.copy()
    return Whole(whole, compiled, compiled.compile())


def prune(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a copy of a spec without what changes no motion.

    Every body has its inertia written out, equal to the compiled one. Gone are geoms
    that can touch nothing, sensors, skins, and meshes, height fields, textures and
    materials that nothing else uses. Joints, actuators and bodies without a name get
    one, since effects refer to names: ``joint1``, ``body1``; an actuator that of
    its joint. Links on fixed joints stay links of their own.

    Raises:
        ValueError: MuJoCo's, where the spec does not compile.

    Example:
        >>> spec = mujoco.MjSpec.from_string(
        ...     "<mujoco><worldbody><body><joint/><geom size='0.1'/></body>"
        ...     "</worldbody></mujoco>")
        >>> slim = prune(spec)
        >>> len(slim.geoms), slim.joints[0].name, round(slim.bodies[1].mass, 3)
        (0, 'joint1', 4.189)
    """
    return prune_whole(compile_whole(spec))


def prune_whole(whole: Whole) -> mujoco.MjSpec:
    """Return what `prune` does, of a spec that is compiled already."""
    slim, compiled, model = whole.spec.copy(), whole.compiled, whole.model
    aligned = _aligned_bodies(compiled)
    needed = _touching(model) | _referred(model) | _held(compiled, model)
    needed |= np.isin(model.geom_bodyid, aligned)
    _write_inertias(slim, [body.id for body in compiled.bodies], model, aligned)
    _name_all(slim)
    ids = [geom.id for geom in compiled.geoms]
    pairs = zip(slim.geoms, ids, strict=True)
    _delete(slim, [geom for geom, number in pairs if not needed[number]])
    # None of them acts on the motion, and they may point at a geom that is gone.
    _delete(slim, [sensor for sensor in slim.sensors if not sensor.plugin.active])
    _delete(slim, [*slim.skins, *slim.tuples])
    _delete_assets(slim)
    return slim


def _touching(model: mujoco.MjModel) -> Mask:
    """Return which geoms can touch another geom, or a flex, (ngeom,)."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return np.zeros(model.ngeom, dtype=np.bool_)
    types, partners = model.geom_contype, model.geom_conaffinity
    match = (types[:, None] & partners) | (partners[:, None] & types)
    welded = model.body_weldid[model.geom_bodyid]
    found: Mask = ((match != 0) & (welded[:, None] != welded)).any(axis=1)
    if model.nflex:
        found |= (types != 0) | (partners != 0)
    return found


def _referred(model: mujoco.MjModel) -> Mask:
    """Return the geoms that contact pairs and tendons name, (ngeom,)."""
    found = np.zeros(model.ngeom, dtype=np.bool_)
    found[model.pair_geom1] = found[model.pair_geom2] = True
    found[model.wrap_objid[np.isin(model.wrap_type, _WRAPS_GEOM)]] = True
    return found


def _held(spec: mujoco.MjSpec, model: mujoco.MjModel) -> Mask:
    """Return the geoms that a fluid pushes, or that a plugin is made of, (ngeom,)."""
    found = np.zeros(model.ngeom, dtype=np.bool_)
    if model.opt.density > 0 or model.opt.viscosity > 0:
        found |= model.geom_fluid[:, 0] > 0
    for geom in spec.geoms:
        found[geom.id] |= bool(geom.plugin.active)
    return found


def _aligned_bodies(spec: mujoco.MjSpec) -> list[int]:
    """Return the bodies whose frame the compiler moves into their centre of mass."""
    free, always = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtAlignFree
    return [
        joint.parent.id
        for joint in spec.joints
        if joint.type == free
        and (
            joint.align == always.mjALIGNFREE_TRUE
            or (joint.align == always.mjALIGNFREE_AUTO and spec.compiler.alignfree)
        )
    ]


def _write_inertias(
    spec: mujoco.MjSpec,
    ids: Sequence[int],
    model: mujoco.MjModel,
    left_alone: Sequence[int],
) -> None:
    for body, number in zip(spec.bodies, ids, strict=True):
        if number <= 0 or number in left_alone:
            continue
        body.explicitinertial = True
        body.mass = model.body_mass[number]
        body.ipos = model.body_ipos[number]
        body.iquat = model.body_iquat[number]
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.inertia = model.body_inertia[number]
        body.fullinertia = np.full(6, np.nan)
    if not left_alone:
        spec.compiler.inertiafromgeom = (
            mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        )
    # What the compiler did to all masses is in them now; a body that an effect adds
    # must not be scaled with them.
    spec.compiler.settotalmass = -1.0
    spec.compiler.boundmass = spec.compiler.boundinertia = 0.0


def _name_all(spec: mujoco.MjSpec) -> None:
    _name(spec.joints, "joint")
    _name(spec.bodies, "body")
    taken = {actuator.name for actuator in spec.actuators}
    for actuator in spec.actuators:
        driven = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
        if not actuator.name and driven and actuator.target not in taken:
            actuator.name = actuator.target
            taken.add(actuator.name)
    _name(spec.actuators, "actuator")


def _name(elements: Sequence[mujoco.MjsJoint], stem: str) -> None:
    taken = {element.name for element in elements}
    # The world is body 0, and has its name.
    for number, element in enumerate(elements, start=int(stem != "body")):
        while not element.name:
            if f"{stem}{number}" not in taken:
                element.name = f"{stem}{number}"
                taken.add(element.name)
            number += 1


def _delete_assets(spec: mujoco.MjSpec) -> None:
    for element in [*spec.geoms, *spec.sites, *spec.tendons, *spec.flexes]:
        element.material = ""
    meshes = {geom.meshname for geom in spec.geoms}
    fields = {geom.hfieldname for geom in spec.geoms}
    _delete(spec, [mesh for mesh in spec.meshes if mesh.name not in meshes])
    _delete(spec, [field for field in spec.hfields if field.name not in fields])
    _delete(spec, [*spec.materials, *spec.textures])


def _delete(spec: mujoco.MjSpec, elements: Iterable[mujoco.MjsGeom]) -> None:
    # Numbers of elements are no longer theirs after the first one is gone.
    for element in list(elements):
        spec.delete(element)
