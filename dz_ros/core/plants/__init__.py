"""Plants in normal form, one a file; `PLANTS` finds them by name."""

from dz_ros.core.plants.base import Plant
from dz_ros.core.plants.wang2004 import Wang2004
from dz_ros.core.registry import Registry

PLANTS = Registry('plant', 'plant.model', 'dz_ros.plants', Plant,
                  {item.name: item for item in (Wang2004,)})
