// A client of `airtact live SCENE --from websocket` for Unity and other programs in C# (.NET Standard 2.0 or later).
//
// In Unity, copy this file into Assets, create one Airtact.Client, and call Foci or Move in Update:
//
//     var client = new Airtact.Client();
//     client.AddSphere("ball", 0.02);
//     client.Move("ball", Airtact.Frames.Point(transform.position), Airtact.Frames.Turn(transform.rotation));
//     client.Foci(new Airtact.Focus { id = "tip", place = "index.pad", strength = 0.5 });
//     Debug.Log(client.State?.state);
//
// No call blocks: messages are sent in the background, and State is the newest state that arrived.

using System;
using System.Collections.Concurrent;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Net.WebSockets;
using System.Runtime.Serialization;
using System.Runtime.Serialization.Json;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace Airtact
{
    /// <summary>A focus; set either point or place.</summary>
    public class Focus
    {
        public string id, place, on;
        public double[] point;
        public double strength = 1.0, modulation = 0.0;

        internal string Json()
        {
            var where = point != null ? "\"point\":" + Text.Of(point) : "\"place\":" + Text.Of(place);
            if (on != null) where += ",\"on\":" + Text.Of(on);
            return $"{{\"id\":{Text.Of(id)},{where},\"strength\":{Text.Of(strength)},\"modulation\":{Text.Of(modulation)}}}";
        }
    }

    [DataContract]
    public class ContactState
    {
        [DataMember(Name = "object")] public string thing;
        [DataMember] public string part;
        [DataMember] public double[] point;
        [DataMember] public double depth;
    }

    [DataContract]
    public class FocusState
    {
        [DataMember] public string id, reason;
        [DataMember] public double[] point;
        [DataMember] public double strength;
        [DataMember] public double? pressure;
    }

    /// <summary>A message from the loop: its state, or with type "rejected" the reason why a message was rejected.</summary>
    [DataContract]
    public class State
    {
        [DataMember] public string type, state, reason;
        [DataMember] public ContactState[] contacts;
        [DataMember] public FocusState[] foci;
    }

    public class Client : IDisposable
    {
        /// <summary>Newest state of the loop; null before the first.</summary>
        public volatile State State;

        /// <summary>Reason of the newest rejection or of a failed connection; null if there was none.</summary>
        public volatile string Rejected;

        readonly ClientWebSocket socket = new ClientWebSocket();
        readonly CancellationTokenSource ended = new CancellationTokenSource();
        readonly BlockingCollection<string> waiting = new BlockingCollection<string>(64);

        public Client(string address = "ws://127.0.0.1:8765")
        {
            Task.Run(() => Run(new Uri(address)));
        }

        /// <summary>Replace the foci of this client. Call this several times per second.</summary>
        public void Foci(params Focus[] foci)
        {
            Send("foci", "\"foci\":[" + string.Join(",", foci.Select(focus => focus.Json())) + "]");
        }

        public void AddSphere(string name, double radius)
        {
            Send("objects", $"\"add\":[{{\"name\":{Text.Of(name)},\"sphere\":{{\"radius\":{Text.Of(radius)}}}}}]");
        }

        public void AddBox(string name, double[] sides)
        {
            Send("objects", $"\"add\":[{{\"name\":{Text.Of(name)},\"box\":{{\"sides\":{Text.Of(sides)}}}}}]");
        }

        /// <summary>Set the pose of an object: a point in metres, and a quaternion x, y, z, w.</summary>
        public void Move(string name, double[] point, double[] turn)
        {
            var pose = $"{{\"translation\":{Text.Of(point)},\"quaternion\":{Text.Of(turn)}}}";
            Send("objects", $"\"move\":[{{\"name\":{Text.Of(name)},\"pose\":{pose}}}]");
        }

        public void Remove(string name)
        {
            Send("objects", $"\"remove\":[{Text.Of(name)}]");
        }

        /// <summary>Send a frame of a hand; omit the landmarks if the hand is lost.</summary>
        public void Hand(string side, double time, long sequence, double[][] landmarks)
        {
            var points = landmarks == null ? "null" : "[" + string.Join(",", landmarks.Select(Text.Of)) + "]";
            Send("hands", $"\"hands\":[{{\"time\":{Text.Of(time)},\"side\":{Text.Of(side)},\"sequence\":{sequence},\"landmarks\":{points}}}]");
        }

        /// <summary>Remove all foci and objects of this client.</summary>
        public void Clear()
        {
            Send("clear", null);
        }

        public void Dispose()
        {
            ended.Cancel();
            socket.Dispose();
        }

        void Send(string type, string values)
        {
            var rest = values == null ? "" : "," + values;
            // Drop the message if 64 others are waiting; newer ones will follow.
            waiting.TryAdd($"{{\"type\":\"{type}\",\"version\":1{rest}}}");
        }

        async Task Run(Uri address)
        {
            try
            {
                await socket.ConnectAsync(address, ended.Token);
                var receiving = Receive();
                foreach (var text in waiting.GetConsumingEnumerable(ended.Token))
                {
                    var bytes = new ArraySegment<byte>(Encoding.UTF8.GetBytes(text));
                    await socket.SendAsync(bytes, WebSocketMessageType.Text, true, ended.Token);
                }
                await receiving;
            }
            catch (Exception fault) when (!ended.IsCancellationRequested)
            {
                Rejected = fault.Message;
            }
            catch (Exception)
            {
                // The client was disposed.
            }
        }

        async Task Receive()
        {
            var reader = new DataContractJsonSerializer(typeof(State));
            var buffer = new ArraySegment<byte>(new byte[65536]);
            while (socket.State == WebSocketState.Open)
            {
                using (var text = new MemoryStream())
                {
                    WebSocketReceiveResult part;
                    do
                    {
                        part = await socket.ReceiveAsync(buffer, ended.Token);
                        text.Write(buffer.Array, 0, part.Count);
                    } while (!part.EndOfMessage);
                    if (part.MessageType == WebSocketMessageType.Close) return;
                    text.Position = 0;
                    var message = (State)reader.ReadObject(text);
                    if (message.type == "state") State = message;
                    else Rejected = message.reason;
                }
            }
        }
    }

    /// <summary>Writes JSON numbers with decimal points, whatever the locale.</summary>
    static class Text
    {
        public static string Of(double value)
        {
            return value.ToString("R", CultureInfo.InvariantCulture);
        }

        public static string Of(double[] values)
        {
            return "[" + string.Join(",", values.Select(Of)) + "]";
        }

        public static string Of(string value)
        {
            return "\"" + value.Replace("\\", "\\\\").Replace("\"", "\\\"") + "\"";
        }
    }

#if UNITY_5_3_OR_NEWER
    /// <summary>
    /// Converts Unity's frame (left-handed, y up) to that of airtact (right-handed, z up) by swapping y and z.
    /// </summary>
    public static class Frames
    {
        public static double[] Point(UnityEngine.Vector3 point)
        {
            return new double[] { point.x, point.z, point.y };
        }

        public static double[] Turn(UnityEngine.Quaternion turn)
        {
            return new double[] { -turn.x, -turn.z, -turn.y, turn.w };
        }
    }
#endif
}
