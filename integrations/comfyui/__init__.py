"""Nodes for ComfyUI that turn a textured mesh into a one-colour printable part. See README.md beside this file."""

from .nodes import comfy_entrypoint

__all__ = ["comfy_entrypoint"]
