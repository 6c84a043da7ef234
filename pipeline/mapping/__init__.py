"""The map of a submap while it grows, its adjustment, and merging of submaps that saw the same place.

A keyframe enters `local_map.LocalMap`, is adjusted with its latest neighbours by `map_adjustment.adjust_window`, and
with all keyframes by `final_adjustment.adjust_maps`, in the same map. `submap_merging.merge_and_adjust` merges maps;
`submap_of_map.to_submap` gives the `submap.Submap` that every front end returns.
"""
