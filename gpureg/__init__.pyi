# The public names, and where each of them lives: what type checkers read, and what __init__.py loads at first use.
from . import metrics, operators, plot, presets, skimage, sources, spectral, tuning, weights
from ._version import __version__
from .backends import BackendUnavailable
from .curves.contents import CurveError, CurveInFile, CurvesFile
from .curves.denoise import denoise_curve
from .curves.files import read_curves, write_curves
from .curves.simplify import simplify_curve
from .curves.skeletons import Skeleton, simplify_skeleton, skeleton
from .gradients.derivatives import Derivatives, derivatives
from .graphs.csr import Graph
from .graphs.files import read_graph, write_graph
from .graphs.grid import GridGraph
from .graphs.networkx import from_networkx, to_networkx
from .graphs.of_points import knn_graph, radius_graph
from .graphs.of_shapes import curve_graph, face_graph, mesh_graph, ring_graph
from .graphs.reordering import reordered
from .images.bilateral import denoise_bilateral
from .images.choose import plan_denoising
from .images.denoise import denoise_image
from .images.grouped_patches import PatchGroups
from .images.inpaint import inpaint_image
from .images.nl_means import denoise_nl_means
from .images.patch_graph import patch_graph
from .images.patch_groups import patch_groups
from .images.plan import DenoisePlan
from .images.run import run_plan
from .images.total_variation import denoise_tv
from .meshes.denoise import denoise_mesh
from .meshes.noise import estimate_mesh_noise
from .meshes.reading import MeshError, MeshFile, read_mesh
from .meshes.segment import MeshSegmentation, segment_mesh
from .meshes.simplify import simplify_mesh
from .meshes.writing import write_mesh
from .model.memory import memory_needed
from .model.result import Interrupted, Result, Stop
from .noise.channel_noise import ChannelNoise
from .noise.photon import PhotonNoise, estimate_photon_noise
from .noise.report import NoiseReport, describe_noise
from .noise.white import estimate_noise
from .points.cluster import cluster_points
from .points.contents import PointsError, PointsFile
from .points.denoise import denoise_points
from .points.files import read_points, write_points
from .points.noise import estimate_point_noise
from .points.patches import patch_knn_graph, point_patches
from .regions.graph import RegionGraph, region_graph
from .regions.partition import energy_partition
from .regions.regions import Regions
from .regions.simplify import simplify_image
from .regions.values import region_values
from .regularization.interpolate import interpolate
from .regularization.labels import propagate_labels
from .regularization.path import Path, regularization_path
from .regularization.regularize import regularize
from .solvers import Certified, Check, Euler, Jacobi

__all__ = [
    "BackendUnavailable",
    "Certified",
    "ChannelNoise",
    "Check",
    "CurveError",
    "CurveInFile",
    "CurvesFile",
    "DenoisePlan",
    "Derivatives",
    "Euler",
    "Graph",
    "GridGraph",
    "Interrupted",
    "Jacobi",
    "MeshError",
    "MeshFile",
    "MeshSegmentation",
    "NoiseReport",
    "PatchGroups",
    "Path",
    "PhotonNoise",
    "PointsError",
    "PointsFile",
    "RegionGraph",
    "Regions",
    "Result",
    "Skeleton",
    "Stop",
    "__version__",
    "cluster_points",
    "curve_graph",
    "denoise_bilateral",
    "denoise_curve",
    "denoise_image",
    "denoise_mesh",
    "denoise_nl_means",
    "denoise_points",
    "denoise_tv",
    "derivatives",
    "describe_noise",
    "energy_partition",
    "estimate_mesh_noise",
    "estimate_noise",
    "estimate_photon_noise",
    "estimate_point_noise",
    "face_graph",
    "from_networkx",
    "inpaint_image",
    "interpolate",
    "knn_graph",
    "memory_needed",
    "mesh_graph",
    "metrics",
    "operators",
    "patch_graph",
    "patch_groups",
    "patch_knn_graph",
    "plan_denoising",
    "plot",
    "point_patches",
    "presets",
    "propagate_labels",
    "radius_graph",
    "read_curves",
    "read_graph",
    "read_mesh",
    "read_points",
    "region_graph",
    "region_values",
    "regularization_path",
    "regularize",
    "reordered",
    "ring_graph",
    "run_plan",
    "segment_mesh",
    "simplify_curve",
    "simplify_image",
    "simplify_mesh",
    "simplify_skeleton",
    "skeleton",
    "skimage",
    "sources",
    "spectral",
    "to_networkx",
    "tuning",
    "weights",
    "write_curves",
    "write_graph",
    "write_mesh",
    "write_points",
]
