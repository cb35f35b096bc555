"""The maker of the paper's roads: a road with its exit, the host in a lane of it, and what is only there."""

from synth3dlanes.draw.cars import cars_along_road
from synth3dlanes.draw.draws import Draw, DrawsOf
from synth3dlanes.draw.makers import Roads, draw_camera, draw_hills, first_shot
from synth3dlanes.draw.roadside import draw_roadside
from synth3dlanes.draw.rules import lane_of_host
from synth3dlanes.draw.symbols import draw_symbols
from synth3dlanes.draw.traffic_elements import draw_elements
from synth3dlanes.draw.works import with_works
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.from_paper import is_wide_enough, paper_network
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.host import HostCamera, Shot
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import MIN_MEDIAN_M, PaperRoad, Scene
from synth3dlanes.world.ground import Ground


def paper_roads(of: DrawsOf, shots: Shots, assets: Assets) -> Roads:
    """The paper's road with its exit."""
    terrain, road, shot = draw_hills(of("terrain")), draw_road(of("road")), first_shot(shots, of("motion"))
    network, draw = paper_network(road, terrain), of("camera")
    u_lane, y_m = draw.rng.random(), draw("y_m")
    lane = lane_of_host(of.params.camera.lane, road.lanes_present(y_m)).draw(u_lane)
    camera = _on_its_road(network, draw_camera(draw, lane, y_m), shot)
    road, camera = with_works(road, camera, of("works"))
    if road.works is not None:
        network = paper_network(road, terrain)

    def stand(scene: Scene, ground: Ground) -> Roadside:
        own = of("structures")
        return draw_elements(
            ground, draw_roadside(ground, of("roadside"), own), of("roadside", "traffic_elements"), own
        )

    return Roads(
        network=network,
        fields={"terrain": terrain, "road": road, "camera": camera, "shot": shot},
        stand=stand,
        drive=lambda scene, ground: cars_along_road(scene, ground.network, of),
        paint=lambda scene, ground: draw_symbols(scene, ground.network, of("symbols")),
    )


def draw_road(draw: Draw) -> PaperRoad:
    """The numbers of the road, by its rules (docs/params.md)."""
    drawn = {field: draw(field.replace("_rad", "_deg")) for field in PaperRoad.model_fields if field != "works"}
    if drawn["topology"] > 2:
        drawn["n_lanes"] = max(drawn["n_lanes"], 2)
    if drawn["n_oncoming"] == 0 or drawn["median_m"] < MIN_MEDIAN_M:
        drawn["median_m"] = 0.0
    road = PaperRoad(**drawn)
    return road if is_wide_enough(road) else road.model_copy(update={"n_oncoming": 0, "median_m": 0.0})


def _on_its_road(network: Network, camera: HostCamera, shot: Shot) -> HostCamera:
    """The host, in the lane beside its own if its own leads from its road within the clip."""
    lane = network.host_lane(camera.lane, camera.y_m)
    beside = [at for at in network.lanes_at(camera.y_m * network.onwards) if abs(at.number - lane.number) == 1]
    # On the inside of a bend a lane is shorter than its stations.
    reached_m = camera.y_m + 2 * shot.speed_m_s * shot.duration_s
    after = network.successors(lane.id) if reached_m * network.onwards >= lane.end_m else []
    if not after or any(at.road == lane.road for at in after):
        return camera
    return camera.model_copy(update={"lane": beside[0].number})
