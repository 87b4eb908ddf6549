// Frames of a moving mesh through Embree: built anew, or refitted, and drawn; with scripts/peers.
// Compiled against the C++ peers' sources, so that rays, packets and shading are theirs.
// moving MESH CAM FRAMES COUNT THREADS SIZE <rebuild|refit> <none|compact|robust> <1|4|8|16>
#define main peer_main
#include "embree_peer.cpp"
#undef main

int main(int argc, char **argv) {
  if (argc != 10) return fprintf(stderr, "moving: give nine arguments\n"), 2;
  Mesh mesh;
  load_mesh(argv[1], mesh);
  Cam cam;
  load_cam(argv[2], cam);
  const size_t frames = atoi(argv[4]), numbers = mesh.nv * 3;
  std::vector<float> positions(frames * numbers);
  FILE *file = fopen(argv[3], "rb");
  if (!file || fread(positions.data(), 4, positions.size(), file) != positions.size())
    return fprintf(stderr, "moving: %s is short\n", argv[3]), 1;
  fclose(file);
  const int size = atoi(argv[6]);
  const bool refit = !strcmp(argv[7], "refit");

  EP peer;
  peer.m = &mesh;
  peer.T = atoi(argv[5]);
  peer.q = RTC_BUILD_QUALITY_LOW;
  peer.flags = !strcmp(argv[8], "compact") ? RTC_SCENE_FLAG_COMPACT : !strcmp(argv[8], "robust") ? RTC_SCENE_FLAG_ROBUST : 0;
  if (refit) peer.flags |= RTC_SCENE_FLAG_DYNAMIC;
  peer.pk = atoi(argv[9]);
  omp_set_num_threads(peer.T);
  peer.prepare();
  const CamB view = basis(cam, size, size);
  std::vector<float> image(size_t(size) * size);
  std::vector<Hit> hits(image.size());
  auto move_to = [&](size_t frame) { memcpy(mesh.v, positions.data() + frame * numbers, numbers * 4); };

  move_to(0);
  peer.build();
  if (refit) {
    // The builder that refits builds once more; from then on it moves boxes only. Static scenes forget it.
    rtcSetGeometryBuildQuality(peer.g, RTC_BUILD_QUALITY_REFIT);
    peer.recommit = true;
    peer.build();
  }
  peer.primary(view, image.data(), nullptr);
  Stat build, draw;
  std::string counts;
  for (size_t frame = 0; frame < frames; frame++) {
    move_to(frame);
    peer.clear();
    const double d0 = run_delay(), t0 = now();
    peer.build();
    const double t1 = now(), d1 = run_delay(), t2 = now();
    peer.primary(view, image.data(), nullptr);
    const double t3 = now(), d2 = run_delay();
    build.add(t1 - t0, d1 - d0);
    draw.add(t3 - t2, d2 - d1);
    peer.primary(view, image.data(), hits.data());
    size_t found = 0;
    for (const Hit &hit : hits) found += hit.prim != MISS;
    counts += (frame ? "," : "") + std::to_string(found);
  }
  printf("{\"build_s\":%.6f,\"render_s\":%.6f,\"tti_s\":%.6f,\"bytes_per_tri\":%.2f,\"hits\":[%s]}\n", build.val(),
         draw.val(), build.val() + draw.val(), double(peer.bytes()) / mesh.nt, counts.c_str());
}
