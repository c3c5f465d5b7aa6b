/* Runs in the guest: libfreenect against the virtual Kinect. A foreign client with its own packet code and its own unpacking,
 * so that our device and our driver cannot be wrong in the same way.
 *
 * freenect-client FRAMES SECONDS: prints frames whole and wrong per stream, and the check values of the tables that
 * libfreenect computes from the calibration served. */
#include <libfreenect.h>
#include <libfreenect_registration.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/time.h>

enum { PIXELS = 640 * 480 };

static int depth_frames, depth_wrong, colour_frames, colour_wrong;

/* The test pattern of tests/common/test_pattern.rs, with its hash(). */
static uint64_t mixed(uint64_t seed, uint64_t index)
{
	uint64_t z = seed ^ index * 0x9e3779b97f4a7c15u;
	z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
	z = (z ^ z >> 27) * 0x94d049bb133111ebu;
	return z ^ z >> 31;
}

static void on_depth(freenect_device *device, void *data, uint32_t stamp)
{
	const uint16_t *depth = data;
	uint64_t number = 0;
	int wrong = 0;
	for (int i = 0; i < 4; i++)
		number |= (uint64_t)(depth[i] & 0xff) << 8 * i;
	for (uint64_t group = 1; group < PIXELS / 4; group++) {
		uint64_t bits = mixed(number, group);
		for (int i = 0; i < 4; i++)
			wrong += depth[4 * group + i] != (bits >> 16 * i & 0x7ff);
	}
	depth_frames++;
	depth_wrong += wrong > 0;
	(void)device, (void)stamp;
}

static void on_colour(freenect_device *device, void *data, uint32_t stamp)
{
	const uint8_t *bayer = data;
	uint64_t number = 0;
	int wrong = 0;
	for (int i = 0; i < 4; i++)
		number |= (uint64_t)bayer[i] << 8 * i;
	for (uint64_t group = 1; group < PIXELS / 8; group++) {
		uint64_t bits = mixed(~number, group);
		for (int i = 0; i < 8; i++)
			wrong += bayer[8 * group + i] != (bits >> 8 * i & 0xff);
	}
	colour_frames++;
	colour_wrong += wrong > 0;
	(void)device, (void)stamp;
}

static uint64_t hash(uint64_t h, uint32_t word)
{
	return (h ^ word) * 1099511628211u;
}

int main(int argc, char **argv)
{
	int frames = argc > 1 ? atoi(argv[1]) : 30;
	double seconds = argc > 2 ? atof(argv[2]) : 30, elapsed = 0;
	freenect_context *context;
	freenect_device *device;
	struct timeval began, now, wait = { 0, 100000 };

	if (freenect_init(&context, NULL) < 0)
		return printf("freenect cannot start\n"), 1;
	freenect_select_subdevices(context, FREENECT_DEVICE_CAMERA);
	printf("freenect sees %d\n", freenect_num_devices(context));
	if (freenect_open_device(context, &device, 0) < 0)
		return printf("freenect cannot open\n"), 1;

	freenect_registration registration = freenect_copy_registration(device);
	const int32_t (*place)[2] = (const int32_t (*)[2])registration.registration_table;
	uint64_t table = 1469598103934665603u, distances = table, places = table;
	for (int i = 0; i < PIXELS; i++)
		for (int axis = 0; axis < 2; axis++)
			table = hash(table, (uint32_t)place[i][axis]);
	/* Beyond 1089 libfreenect's 16-bit conversion is undefined; it delivers at most 10 000. */
	for (int raw = 0; raw < 1089; raw++) {
		uint16_t mm = registration.raw_to_mm_shift[raw];
		distances = hash(distances, mm < 10000 ? mm : 10000);
	}
	/* Where depth pixels land in the colour picture. */
	for (int i = 0; i < PIXELS; i += 97)
		for (int z = 450; z < 4000; z += 37) {
			int32_t x = place[i][0] + registration.depth_to_rgb_shift[z];
			int outside = x < 0 || x / 256 >= 640;
			places = hash(places, outside ? 0xffffffffu : (uint32_t)(place[i][1] * 640 + x / 256));
		}
	printf("tables distances %016llx places %016llx\n", (unsigned long long)distances, (unsigned long long)places);
	printf("whole registration table %016llx\n", (unsigned long long)table);

	freenect_set_depth_callback(device, on_depth);
	freenect_set_video_callback(device, on_colour);
	freenect_set_depth_mode(device, freenect_find_depth_mode(FREENECT_RESOLUTION_MEDIUM, FREENECT_DEPTH_11BIT));
	freenect_set_video_mode(device, freenect_find_video_mode(FREENECT_RESOLUTION_MEDIUM, FREENECT_VIDEO_BAYER));
	if (freenect_start_depth(device) < 0 || freenect_start_video(device) < 0)
		return printf("freenect cannot stream\n"), 1;
	gettimeofday(&began, NULL);
	while ((depth_frames < frames || colour_frames < frames) && elapsed < seconds) {
		if (freenect_process_events_timeout(context, &wait) < 0)
			break;
		gettimeofday(&now, NULL);
		elapsed = (double)(now.tv_sec - began.tv_sec) + (double)(now.tv_usec - began.tv_usec) * 1e-6;
	}
	freenect_stop_depth(device);
	freenect_stop_video(device);
	printf("freenect in %.1f s: depth frames %d wrong %d, colour frames %d wrong %d\n",
	       elapsed, depth_frames, depth_wrong, colour_frames, colour_wrong);
	freenect_close_device(device);
	freenect_shutdown(context);
	return depth_frames == 0 || colour_frames == 0 || depth_wrong > 0 || colour_wrong > 0;
}
